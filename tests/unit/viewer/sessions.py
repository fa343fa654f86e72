"""Sessions in miniature: a rocking disc, a hanging strip, a plate in space, whose kinematics is known."""

from dataclasses import replace

import torch

from lagsplat.config.compose import compose
from lagsplat.forces.operating_point import OperatingPoint
from lagsplat.matter.body_motion import BodyMotion
from lagsplat.matter.field import MatterField
from lagsplat.monomials import make_wide_ball
from lagsplat.viewer.simulation.history import read_recorded_data
from lagsplat.viewer.simulation.session import Session
from tests.unit.forces.rocking import (
    CONTACT,
    deviate_stretch,
    draw_springs,
    hanging,
    hold_polynomial_strip,
    rocking,
)
from tests.unit.forces.solid import turning


def session(operating_point: OperatingPoint | None = None, *overrides: str) -> Session:
    operating_point = operating_point or rocking()
    settings = compose("system=toy", *overrides)
    recorded = read_recorded_data(operating_point.chart, names=("push",), units=("N",))
    return Session(operating_point, recorded, settings.viewer, settings.forces)


def swing() -> Session:
    """The disc whose matter turns rigidly about `CONTACT`, by one radian a unit of the coordinate."""
    point = rocking()
    turn = torch.tensor([[0.0, 0.0, 1.0]], dtype=torch.float64)
    body = BodyMotion(torch.tensor(CONTACT).double(), 1.0, 0, 1, make_wide_ball(1), turn)
    return session(replace(point, matter=MatterField((body,), point.matter.points, point.matter.body)))


def strip() -> Session:
    return session(hanging())


def uncertain(deviation: float) -> Session:
    """The strip, whose spring that stretches is known up to a share, and its motion to a tenth of that."""
    point = deviate_stretch(hold_polynomial_strip(), share=0.1 * deviation)
    one = session(point)
    draws = draw_springs(point, deviation=deviation)
    return Session(point, one.recorded, one.config, one.forces, draws)


def plate() -> Session:
    return session(turning())
