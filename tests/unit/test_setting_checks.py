"""The messages of settings outside their domain."""

from types import SimpleNamespace

import pytest

from lagsplat.setting_checks import (
    require_choice,
    require_interval,
    require_least,
    require_positive,
    require_setting,
)


def test_a_message_names_the_key_its_value_and_the_remedy() -> None:
    config = SimpleNamespace(steps=0, rate=float("nan"))
    with pytest.raises(ValueError, match=r"ode\.steps=0 must be at least 1; set it in conf/ode or with"):
        require_least(config, "ode", 1, "steps")
    with pytest.raises(ValueError, match=r"ode\.rate=nan must be positive"):
        require_positive(config, "ode", "rate")
    require_setting("ode.rate", 0.1, True, "must be small")
    require_least(config, "ode", 0, "steps")


def test_ends_of_an_interval_belong_to_it_where_its_brackets_say_so() -> None:
    config = SimpleNamespace(none=0.0, half=0.5, all=1.0)
    require_interval(config, "ode", "[0, 1]", "none", "half", "all")
    require_interval(config, "ode", "(0, 1]", "half", "all")
    with pytest.raises(ValueError, match=r"ode\.none=0\.0 must lie in \(0, 1\]; set it in conf/ode"):
        require_interval(config, "ode", "(0, 1]", "half", "none")
    with pytest.raises(ValueError, match=r"ode\.all=1\.0 must lie in \[0, 1\)"):
        require_interval(config, "ode", "[0, 1)", "none", "all")


def test_a_choice_is_one_of_the_known() -> None:
    require_choice(SimpleNamespace(method="rk4"), "ode", "method", ("rk4", "midpoint"))
    with pytest.raises(ValueError, match=r"ode\.method=euler is none of rk4, midpoint"):
        require_choice(SimpleNamespace(method="euler"), "ode", "method", ("rk4", "midpoint"))
