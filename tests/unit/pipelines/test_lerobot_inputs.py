"""A LeRobot dataset as the real side of a diagnosis: joints by name, actions as targets, units told."""

from pathlib import Path

import pytest

from lagsplat.config.compose import compose
from lagsplat.pipelines.diagnosis_inputs import open_diagnosis_inputs

DATASET = Path(__file__).parents[1] / "io" / "lerobot" / "data" / "v30"
SIM = """
def elbow(q, v, u):
    return 400.0 * (u[..., :1] - q) - 30.0 * v
"""


@pytest.mark.filterwarnings("ignore:v30")
def test_one_joint_of_a_log_is_compared_with_a_program(tmp_path: Path) -> None:
    (tmp_path / "arm.py").write_text(SIM)
    columns = "diagnose.columns={q0: elbow_flex.pos, u0: elbow_flex.pos}"
    config = compose(columns, "diagnose.joint_unit=degree").diagnose
    inputs = open_diagnosis_inputs(f"{tmp_path / 'arm.py'}:elbow", str(DATASET), config)
    assert dict(inputs.targets) == {"u0": "q0"}
    assert [motion.segments for motion in inputs.real] == [((0, 60), (60, 105))]
    assert abs(inputs.real[0].q).max() < 2.1  # radians
