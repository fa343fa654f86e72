"""Domains of the evaluation settings."""

from pathlib import Path

import pytest
from omegaconf import OmegaConf

from lagsplat.evaluate.config import EvaluateConfig

DEFAULTS = Path(__file__).parents[3] / "conf" / "evaluate" / "default.yaml"


def compose(**changes: object) -> EvaluateConfig:
    """The default choice with a few keys changed, typed as planning types it."""
    schema = OmegaConf.structured(EvaluateConfig)
    return OmegaConf.to_object(OmegaConf.merge(schema, OmegaConf.load(DEFAULTS), changes))


def test_defaults_are_the_published_protocol():
    config = compose()
    assert (config.starts, config.seed, config.horizon_s, config.periods) == (50, 0, 0.5, 2.0)
    assert config.period_s is None


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("starts", 0),
        ("horizon_s", -0.5),
        ("skip_s", -1.0),
        ("confidence", 1.0),
        ("free_rate_fraction", 0.0),
        ("period_s", 0.0),
        ("divergence_factor", 0.5),
        ("window_cycles", 2.0),
    ],
)
def test_message_names_key_and_value(key, value):
    with pytest.raises(ValueError, match=rf"evaluate\.{key}={value}"):
        compose(**{key: value})
