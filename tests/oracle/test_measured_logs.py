"""A diagnosis of measured swings against what their decay alone says, without any simulation.

Source: MultiArm pendulum, Kaheman et al. 2022, arXiv:2205.06231; an arm that swings freely on a locked cart.
"""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy.io import loadmat
from scipy.special import ellipk

from lagsplat.config.compose import compose
from lagsplat.pipelines.diagnosis import diagnose_files
from lagsplat.pipelines.diagnosis_inputs import open_diagnosis_inputs

FRICTION = {
    "coulomb_friction",
    "stribeck_friction",
    "asymmetric_friction",
    "load_dependent_friction",
    "viscous_damping",
    "quadratic_drag",
}
FRICTIONLESS = """
import numpy as np

class Pendulum:
    def mass(self, q):
        return np.ones((*np.shape(q)[:-1], 1, 1))

    def potential(self, q):
        return {square} * np.cos(q[..., 0])
"""


@pytest.fixture(scope="module")
def swing(shared_data: Path) -> np.ndarray:
    """The single arm's swing at 40 Hz, (N, 2): time [s] and angle [rad], which is pi where it hangs."""
    path = shared_data / "logs" / "multiarm_pendulum" / "SinglePendulumDataForParameterEstimation.mat"
    if not path.is_file():
        pytest.skip(f"no recording at {path}")
    held = loadmat(path, squeeze_me=True)
    parts = [(held[f"Time_{k}"], held[f"Y_{k}"]) for k in ("id", "vad")]
    time = np.concatenate([np.ravel(t) for times, _ in parts for t in times])
    angle = np.concatenate([np.asarray(y)[0] for _, rows in parts for y in rows])
    return np.stack([time, angle], axis=1)[::25]


@pytest.fixture(scope="module")
def decay(swing: np.ndarray) -> dict[str, float]:
    """Small-swing frequency squared, Coulomb friction and quadratic drag, by peaks of each half swing.

    Friction ``f`` takes ``2 f / (pi w)`` of the amplitude a second, drag ``c`` takes ``4 c w A^2 / (3 pi)``.
    """
    time, q = swing[:, 0], swing[:, 1] - np.pi
    rise = np.flatnonzero((q[:-1] < 0) & (q[1:] >= 0))
    cross = time[rise] - q[rise] * np.diff(time)[rise] / (q[rise + 1] - q[rise])
    top = np.array([np.ptp(q[a:b]) / 2 for a, b in pairwise(rise)])
    small = top < 0.8
    w = float(np.median(4 * ellipk(np.sin(top / 2) ** 2)[small] / np.diff(cross)[small]))
    middle = 0.5 * (cross[1:] + cross[:-1])
    loss, amplitude = -np.diff(top) / np.diff(middle), 0.5 * (top[1:] + top[:-1])
    columns = np.stack([np.full_like(loss, 2 / (np.pi * w)), 4 * w * amplitude**2 / (3 * np.pi)], axis=1)
    (coulomb, drag), *_ = np.linalg.lstsq(columns, loss, rcond=None)
    return {"square": w**2, "coulomb": float(coulomb), "drag": float(drag)}


@pytest.fixture
def files(swing: np.ndarray, decay: dict[str, float], tmp_path: Path) -> tuple[str, str]:
    """A sim without friction, and the recording."""
    (tmp_path / "arm.py").write_text(FRICTIONLESS.format(square=decay["square"]))
    np.savetxt(tmp_path / "arm.csv", swing, delimiter=",", header="t,q0", comments="")
    return f"{tmp_path / 'arm.py'}:Pendulum", str(tmp_path / "arm.csv")


def test_the_decay_is_that_of_dry_friction_and_drag(decay: dict[str, float]) -> None:
    assert decay["square"] == pytest.approx(64.1, rel=0.01)
    assert decay["coulomb"] > 0.1
    assert decay["drag"] > 0.002


def test_a_frictionless_sim_swings_as_fast_as_the_arm(
    files: tuple[str, str], decay: dict[str, float]
) -> None:
    pair = open_diagnosis_inputs(*files, compose().diagnose)
    stiffness = pair.sim.model.stiffness[0, 0] / pair.sim.model.inertia[0, 0]
    assert stiffness == pytest.approx(decay["square"], rel=0.01)
    assert pair.checked.undetermined == ()


@pytest.mark.slow
def test_a_frictionless_sim_lacks_friction(files: tuple[str, str], tmp_path: Path) -> None:
    found = diagnose_files(*files, tmp_path / "out", compose().diagnose, command="")
    named = next(c for c in found.candidates if c.name not in ("none", "unknown"))
    assert found.verdict in ("effect", "unknown")
    assert named.name in FRICTION
    assert named.closure is not None
    assert named.closure.value == pytest.approx(1.0, abs=0.15)
    assert found.where is not None
    kinds = {name: share for name, share in found.where.components.items() if name != "unexplained"}
    assert max(kinds, key=lambda name: kinds[name]) == "dissipative"
    assert found.gap is not None
    assert 0.005 < found.gap.before < 0.05
    assert found.gap.after < 0.3 * found.gap.before
