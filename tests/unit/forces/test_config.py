"""Settings outside their domain name themselves."""

from dataclasses import replace

import pytest

from lagsplat.config.compose import compose

FORCES = compose().forces


@pytest.mark.parametrize(
    "changes",
    [
        {"brush": 0.0},
        {"response": 1.5},
        {"points": 1},
        {"directions": 1},
        {"levels": []},
        {"levels": [0.5, 0.1]},
        {"periods": 0.0},
    ],
)
def test_values_outside_the_domain_are_refused(changes):
    with pytest.raises(ValueError, match=rf"forces\.{next(iter(changes))}="):
        replace(FORCES, **changes)
