"""The run that browsers are shown: a bright disc that rocks before a dark wall, from the unit tests."""

from tests.unit.forces.rocking import HEIGHT, WIDTH, rocking
from tests.unit.viewer.sessions import session

TOP = (16.0, 8.0)
"""On the disc, above the point about which it turns [px]."""
WALL = (28.0, 21.0)
SIZE = (WIDTH, HEIGHT)


def disc(*overrides: str):
    return session(rocking(), *overrides)
