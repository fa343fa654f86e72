"""Words that only a film has stay out of what is said of a log."""

from lagsplat.diagnose.effects.registry import list_effects
from tests.unit.report.diagnosis.test_html import OF_FILMS


def test_no_effect_is_described_as_of_a_film() -> None:
    for effect in list_effects():
        mujoco = effect.mujoco if isinstance(effect.mujoco, str) else ""
        words = (effect.title, effect.what, effect.symptom, effect.remedy, effect.short_title, effect.needs)
        assert OF_FILMS.findall(" ".join((*words, effect.equation, mujoco))) == []
