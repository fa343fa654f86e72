"""Settings of the interactive simulation. Torch-free, so that planning stays fast."""

from dataclasses import dataclass

from lagsplat.setting_checks import require_positive, require_setting


@dataclass  # not frozen: OmegaConf turns frozen dataclasses into read-only nodes
class ViewerConfig:
    """Settings of the live page and of an interactive session."""

    host: str  # address that the server listens on; any other than loopback opens it to the network
    port: int  # first port to try; the next free one is taken
    pictures_hz: float  # largest number of frames a second; the dynamics keep the rate of the recording
    side: int  # longer side of the drawn image [px]
    window: int  # longer side of the image that each visitor sees of a run in space [px]
    beyond: float
    """Distance from the recorded states that still counts as covered, as a share of their rms spread."""
    divergence: float
    """Distance from rest at which the integration stops, as a multiple of the visited radius."""
    history_s: float  # time span of the live plots [s]
    log_s: float  # time span of a session that is kept for a file [s]; older steps are dropped

    def __post_init__(self) -> None:
        require_positive(self, "viewer", "pictures_hz", "side", "beyond", "history_s", "log_s")
        for key in ("side", "window"):
            size = getattr(self, key)
            require_setting(f"viewer.{key}", size, 16 <= size <= 2048, "must be from 16 to 2048 pixels")
        rule = "must be a port, or 0 for any free one"
        require_setting("viewer.port", self.port, 0 <= self.port < 65536, rule)
        require_setting("viewer.divergence", self.divergence, self.divergence > 1.0, "must exceed 1")
