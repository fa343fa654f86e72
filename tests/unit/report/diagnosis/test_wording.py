"""Words that only a film has stay out of what is said of a log."""

import pytest

from lagsplat.diagnose.data_quality.noise import measure_noise
from lagsplat.diagnose.effects.excitation import assess_excitation
from lagsplat.diagnose.effects.registry import list_effects
from lagsplat.io.trajectory.trajectory import Trajectory
from tests.unit.diagnose.motions import PERIOD_S, multisine, swing
from tests.unit.report.diagnosis.test_html import OF_FILMS


def test_no_effect_is_described_as_of_a_film() -> None:
    for effect in list_effects():
        mujoco = effect.mujoco if isinstance(effect.mujoco, str) else ""
        words = (effect.title, effect.what, effect.symptom, effect.remedy, effect.short_title, effect.needs)
        assert OF_FILMS.findall(" ".join((*words, effect.equation, mujoco))) == []


@pytest.mark.parametrize("motion", [swing(), swing(seconds=2.0, rate_hz=10.0), swing(drive=multisine(900))])
def test_no_advice_asks_for_a_film(motion: Trajectory) -> None:
    noise = measure_noise([motion], period_s=PERIOD_S)
    rows = assess_excitation([motion], period_s=PERIOD_S, noise=noise)
    assert OF_FILMS.findall(" ".join(row.reason + row.record for row in rows)) == []
