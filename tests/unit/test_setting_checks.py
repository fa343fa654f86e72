"""The messages of settings outside their domain."""

from types import SimpleNamespace

import pytest

from lagsplat.setting_checks import require_least, require_positive, require_setting


def test_a_message_names_the_key_its_value_and_the_remedy() -> None:
    config = SimpleNamespace(steps=0, rate=float("nan"))
    with pytest.raises(ValueError, match=r"ode\.steps=0 must be at least 1; set it in conf/ode or with"):
        require_least(config, "ode", 1, "steps")
    with pytest.raises(ValueError, match=r"ode\.rate=nan must be positive"):
        require_positive(config, "ode", "rate")
    require_setting("ode.rate", 0.1, True, "must be small")
    require_least(config, "ode", 0, "steps")
