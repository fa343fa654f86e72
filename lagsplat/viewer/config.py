"""Settings of the interactive simulation. Torch-free, so that planning stays fast."""

from dataclasses import dataclass


@dataclass  # not frozen: OmegaConf turns frozen dataclasses into read-only nodes
class ViewerConfig:
    """Where the live page is served, how it is paced and what it keeps.

    Raises:
        ValueError: a value outside its domain.
    """

    host: str
    """Address that the server listens on; anything but loopback opens it to the network."""
    port: int
    """The first one tried; the next free one is taken."""
    pictures_hz: float
    """Pictures a second at most; the dynamics keep the recording's rate whatever the pictures do."""
    side: int
    """Longer side of the drawn picture [px]."""
    window: int
    """The same of what each visitor sees of a run in space."""
    reach: float
    """Of the picture's width: the drag that drives the state ``forces.response`` of the visited range."""
    beyond: float
    """Of the rms spread of the recorded states: how far from the nearest of them is still covered."""
    divergence: float
    """Of how far the recorded states reach: the integration stops beyond it."""
    history_s: float
    """How much the live plots show [s]."""
    log_s: float
    """How much of a session is kept for a file [s]; older samples are dropped."""

    def __post_init__(self) -> None:
        """Check the domains."""
        for key in ("pictures_hz", "side", "reach", "beyond", "history_s", "log_s"):
            _require(key, getattr(self, key), getattr(self, key) > 0, "must be positive")
        for key in ("side", "window"):
            size = getattr(self, key)
            _require(key, size, 16 <= size <= 2048, "must be from 16 to 2048 pixels")
        _require("port", self.port, 0 <= self.port < 65536, "must be a port, or 0 for any free one")
        _require("divergence", self.divergence, self.divergence > 1.0, "must exceed 1")


def _require(key: str, value: object, holds: bool, rule: str) -> None:
    if not holds:
        raise ValueError(f"viewer.{key}={value} {rule}; set it in conf/viewer or with viewer.{key}=...")
