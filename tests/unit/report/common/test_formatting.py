"""Digits follow the uncertainty, and certainty is never printed."""

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lagsplat.report.common.formatting import (
    MINUS,
    append_unit,
    format_interval,
    format_number,
    format_percent,
    format_probability,
    format_unit,
)


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "0"),
        (0.996, "1.0"),
        (31.4, "31"),
        (1234.0, "1200"),
        (-0.0123, f"{MINUS}0.012"),
        (4.2e-7, "4.2·10⁻⁷"),
        (float("inf"), "∞"),
        (float("nan"), "not finite"),
        (999_999.0, "1.0·10⁶"),
    ],
)
def test_numbers(value, text):
    assert format_number(value) == text


@given(st.floats(-1e5, 1e5).filter(lambda x: abs(x) > 1e-3))
def test_numbers_are_right_to_their_digits(value):
    text = format_number(value).replace(MINUS, "-")
    assert abs(float(text) - value) <= 0.0501 * abs(value)


@given(st.floats(-1e3, 1e3), st.floats(0.0, 10.0), st.floats(0.0, 10.0))
def test_an_interval_keeps_its_width(value, below, above):
    texts = format_interval(value, value - below, value + above)
    low, high = (float(re.sub("·10.*", "", text).replace(MINUS, "-")) for text in texts[1:])
    if below + above > 1e-4 * max(1.0, abs(value)):  # narrower than that, six digits do not show it
        assert high - low == pytest.approx(below + above, rel=0.2)


def test_intervals_share_their_decimals():
    assert format_interval(0.80123, 0.7713, 0.8321) == ("0.801", "0.771", "0.832")
    assert format_interval(120.3, 90.0, 150.0) == ("120", "90", "150")
    assert format_interval(0.5, None, 0.7) == ("0.500", "–", "0.700")
    assert format_interval(0.5, 0.5, 0.5) == ("0.500", "0.500", "0.500")


@given(st.floats(0.0, 1.0))
def test_no_probability_is_certain(p):
    text = format_probability(p)
    assert text == "< 0.01" or 0.01 <= float(text) <= 0.99


def test_shares_and_units():
    assert [format_percent(x) for x in (0.314, 0.0421, 0.05, 0.0, 1e-5, -0.2)] == [
        "31 %",
        "4.2 %",
        "5.0 %",
        "0 %",
        "< 0.1 %",
        f"{MINUS}20 %",
    ]
    assert format_unit("1/({q}^2 s^2)") == "1/({q}² s²)"
    assert append_unit("3", "1") == "3"
    assert append_unit("3", "q1/s^2") == "3\u00a0q1/s²"
