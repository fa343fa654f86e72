import numpy as np
import pytest

from lagsplat.systems.arm import build_arm
from lagsplat.systems.truth import compute_truth, load_truth, save_truth


@pytest.fixture(scope="module")
def truth(load):
    arm = build_arm(load("krauss_2seg").arm)
    generator = np.random.default_rng(0)
    states, velocities = generator.uniform(-0.3, 0.3, (2, 30, 4))
    return arm, compute_truth(
        arm,
        states,
        velocities,
        pressures=np.zeros((30, 4)),
        forces=np.zeros((30, 4)),
        rest=arm.equilibrium(np.zeros(4)),
        modes=arm.modes(),
    )


def test_truth_repeats_the_equations(truth):
    arm, found = truth
    assert list(found.mass_frames) == [0, 20]
    for frame, mass in zip(found.mass_frames, found.mass_matrices, strict=True):
        np.testing.assert_array_equal(mass, arm.mass(found.states[frame]))
    v, mass = found.velocities[20], found.mass_matrices[1]
    assert found.kinetic_energy[20] == pytest.approx(0.5 * v @ mass @ v)
    np.testing.assert_array_equal(found.decay_rates_per_s, arm.modes().decay_per_s)


def test_truth_survives_the_disk(truth, tmp_path):
    save_truth(tmp_path / "truth.safetensors", truth[1], {"seed": 5})
    found, header = load_truth(tmp_path / "truth.safetensors")
    assert header["seed"] == 5
    for name, value in vars(truth[1]).items():
        np.testing.assert_array_equal(getattr(found, name), value)


@pytest.mark.parametrize("room", ["splat", "stage1", "chart", "stage2"])
def test_training_cannot_see_the_truth(repository, room):
    for module in (repository / "lagsplat" / room).glob("*.py"):
        assert "lagsplat.systems" not in module.read_text(), f"{module} reads the simulated truth"
