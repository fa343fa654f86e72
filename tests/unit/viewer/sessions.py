"""Sessions in miniature: a rocking disc, a hanging strip, a plate in space, whose kinematics is known."""

from lagsplat.config.compose import compose
from lagsplat.forces.equilibrium import OperatingPoint
from lagsplat.viewer.simulation.history import read_recorded_data
from lagsplat.viewer.simulation.session import Session
from tests.unit.forces.rocking import hanging, rocking
from tests.unit.forces.solid import turning


def session(operating_point: OperatingPoint | None = None, *overrides: str) -> Session:
    operating_point = operating_point or rocking()
    settings = compose("system=toy", *overrides)
    recorded = read_recorded_data(operating_point.chart, names=("push",), units=("N",))
    return Session(operating_point, recorded, settings.viewer, settings.forces)


def strip() -> Session:
    return session(hanging())


def plate() -> Session:
    return session(turning())
