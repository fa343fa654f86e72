"""Values of effects that are planted in a simulated arm to be found again. Imports no torch."""

from dataclasses import dataclass


@dataclass  # not frozen: OmegaConf turns frozen dataclasses into read-only nodes
class PlantedConfig:
    """What one recording has and the unmodified arm has not; zeros change nothing.

    ``tip_mass`` [kg] more in the tip cap; pressures reach the chambers by a first-order lag of
    ``actuator_lag_s`` [s]; each bend rubs with a torque that ``dry_friction`` [rad] of bending would balance.
    """

    tip_mass: float
    actuator_lag_s: float
    dry_friction: float

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if value < 0:
                raise ValueError(f"planted.{name} = {value}: give 0 for none, or a positive amount.")


@dataclass  # not frozen, for the same reason
class PlantsConfig:
    """Second recordings of an arm, ``n_frames`` each, driven by ``seed``; one for each of ``effects``.

    An effect bears the name under which a diagnosis should find it again, or ``none``.
    """

    n_frames: int
    seed: int
    effects: dict[str, PlantedConfig]

    def __post_init__(self) -> None:
        if self.seed == 0:
            raise ValueError("planted.seed = 0 is the drive the sim was fitted to; choose another.")
