"""Neural differential equations: their laws, rollouts, training and resumption."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from omegaconf import OmegaConf

import lagsplat.baselines.neural_ode_fit as fit
from lagsplat.baselines.config import OdeConfig
from lagsplat.baselines.neural_ode import STRUCTURES, LatentOde, load_ode, roll_out_ode, save_ode
from lagsplat.baselines.neural_ode_fit import fit_ode
from lagsplat.chart.trajectory import EncodedTrajectory

CONF = Path(__file__).parents[3] / "conf" / "ode" / "default.yaml"
DT_S = 1 / 30


def settings(**changes: object) -> OdeConfig:
    small = {"hidden": 16, "steps": 40, "batch": 16}
    schema = OmegaConf.structured(OdeConfig)
    return OmegaConf.to_object(OmegaConf.merge(schema, OmegaConf.load(CONF), small, changes))


def swing(frames: int = 90, *, uneven: bool = False) -> EncodedTrajectory:
    time_s = DT_S * np.arange(frames)
    if uneven:
        time_s = time_s + 0.2 * DT_S * np.random.default_rng(0).uniform(size=frames)
    q = np.exp(-0.3 * time_s) * np.cos(2 * np.pi * 2.0 * time_s)
    return EncodedTrajectory(q[:, None], np.zeros((frames, 0)), time_s, ((0, frames),))


def make(structure: str, d: int = 2, n_u: int = 0, **changes: object) -> LatentOde:
    torch.manual_seed(0)
    given = {"hidden": 8, "layers": 2, "method": "rk4", "time_unit_s": 0.1, **changes}
    return STRUCTURES[structure](d, n_u, **given)


def free(batch: int, states: int) -> np.ndarray:
    return np.zeros((batch, states, 0))


@pytest.mark.parametrize("structure", list(STRUCTURES))
def test_frames_of_other_spacings_lie_on_the_same_path(structure: str) -> None:
    ode = make(structure)
    q, v = np.random.default_rng(0).normal(size=(2, 3, 2))
    even = roll_out_ode(ode, q, v, free(3, 41), DT_S / 4)
    steps_s = DT_S / 4 * np.tile([1.0, 3.0], (3, 10))
    uneven = roll_out_ode(ode, q, v, free(3, 21), steps_s)
    np.testing.assert_allclose(uneven[:, ::2], even[:, ::4], rtol=0, atol=2e-3)


@pytest.mark.parametrize("structure", list(STRUCTURES))
def test_an_input_counts_by_its_size_in_the_training_part(structure: str) -> None:
    q, v = np.random.default_rng(0).normal(size=(2, 3, 2))
    driven = np.random.default_rng(1).normal(size=(3, 20, 2))
    paths = []
    for scale in (1.0, 1e5):
        ode = make(structure, n_u=2)
        ode.normalize_by(scale * driven[0])
        paths.append(roll_out_ode(ode, q, v, scale * driven, DT_S))
    np.testing.assert_allclose(paths[0], paths[1], rtol=1e-9, atol=1e-12)
    assert np.abs(paths[0] - roll_out_ode(ode, q, v, 0 * driven, DT_S)).max() > 1e-3


def test_a_hamiltonian_law_never_gains_energy_and_moves_at_its_velocity() -> None:
    ode = make("hamiltonian", d=3)
    start = torch.randn(5, 6, dtype=torch.float64)
    torch.testing.assert_close(ode.leave(ode.enter(start)[None])[0], start)
    instants_s = 1e-3 * torch.arange(400, dtype=torch.float64)
    with torch.no_grad():
        path = ode.rollout(start, torch.zeros(400, 5, 0, dtype=torch.float64), instants_s)
        energy = torch.stack([ode.measure_energy(ode.enter(states)) for states in path])
    assert (energy.diff(dim=0) <= 1e-12).all()
    assert (energy[-1] < energy[0] - 1e-3).all()
    q, v = path.split(3, dim=2)
    moved = (q[2:] - q[:-2]) / (2e-3 / ode.time_unit_s)
    torch.testing.assert_close(moved, v[1:-1], rtol=1e-4, atol=1e-4)


def test_without_damping_its_energy_is_kept() -> None:
    ode = make("hamiltonian", d=2)
    potential, mass, damping, _ = ode.parts
    with torch.no_grad():
        for weight in ode.network[-1].parameters():
            weight[potential + mass : potential + mass + damping] = 0.0
    start = torch.randn(4, 4, dtype=torch.float64)
    with torch.no_grad():
        instants_s = 1e-3 * torch.arange(300, dtype=torch.float64)
        path = ode.rollout(start, torch.zeros(300, 4, 0, dtype=torch.float64), instants_s)
        energy = torch.stack([ode.measure_energy(ode.enter(states)) for states in path])
    torch.testing.assert_close(energy, energy[:1].expand_as(energy), rtol=1e-8, atol=1e-9)


@pytest.mark.parametrize(("structure", "uneven"), [("none", False), ("none", True), ("hamiltonian", False)])
def test_it_learns_a_swing_over_its_windows(structure: str, uneven: bool) -> None:
    train = swing(uneven=uneven)
    ode, curve = fit_ode(train, np.eye(1), settings(steps=200, structure=structure), seed=0)
    assert curve[-1].loss < 0.05 * curve[0].loss
    assert ode.time_unit_s == pytest.approx(1 / (2 * np.pi * 2.0), rel=0.1)
    path = roll_out_ode(ode, np.array([[1.0]]), np.array([[-0.3]]), free(1, 15), DT_S)[0, :, 0]
    truth = np.exp(-0.3 * DT_S * np.arange(15)) * np.cos(4 * np.pi * DT_S * np.arange(15))
    assert np.abs(path - truth).max() < 0.25


def test_it_learns_what_an_input_does() -> None:
    rng, time_s = np.random.default_rng(0), DT_S * np.arange(300)
    force = np.repeat(rng.normal(size=20), 15)
    q, v = np.zeros(300), np.zeros(300)
    for i in range(299):
        v[i + 1] = v[i] + DT_S * (3.0 * force[i] - 20.0 * q[i] - 2.0 * v[i])
        q[i + 1] = q[i] + DT_S * v[i + 1]
    train = EncodedTrajectory(q[:, None] / q.std(), 7.0 + 100 * force[:, None], time_s, ((0, 300),))
    config = settings(steps=120, structure="hamiltonian", method="midpoint")
    ode, _ = fit_ode(train, np.eye(1), config, seed=0)
    starts = np.arange(10, 270, 10)
    window = starts[:, None] + np.arange(15)
    start = train.latents[starts], np.gradient(train.latents[:, 0], DT_S)[starts, None]

    def miss(inputs: np.ndarray) -> float:
        return float(np.square(roll_out_ode(ode, *start, inputs, DT_S) - train.latents[window]).mean())

    assert miss(train.inputs[window]) < 0.5 * miss(np.full((len(starts), 15, 1), train.inputs.mean()))


def test_a_killed_training_ends_with_the_same_bits(tmp_path, monkeypatch) -> None:
    config = replace(settings(), checkpoint_every_s=0.0)
    whole, _ = fit_ode(swing(), np.eye(1), config, seed=1)

    class Killed(Exception):
        pass

    steps = iter(range(40))

    def until(*given, real=fit._windows):
        if next(steps) == 21:
            raise Killed
        return real(*given)

    path = tmp_path / "state.pt"
    with monkeypatch.context() as patch:
        patch.setattr(fit, "_windows", until)
        with pytest.raises(Killed):
            fit_ode(swing(), np.eye(1), config, seed=1, checkpoint=path, identity="a")
    again, curve = fit_ode(swing(), np.eye(1), config, seed=1, checkpoint=path, identity="a")
    assert curve[-1].step == 40
    for name, value in whole.state_dict().items():
        assert torch.equal(again.state_dict()[name], value), name


@pytest.mark.parametrize("structure", list(STRUCTURES))
def test_it_comes_back_from_its_file(tmp_path: Path, structure: str) -> None:
    ode = make(structure, d=1, n_u=1)
    ode.normalize_by(np.array([[3.0], [5.0]]))
    save_ode(tmp_path / "ode.safetensors", ode, {"wall_s": 2.0})
    again, header = load_ode(tmp_path / "ode.safetensors")
    assert header["wall_s"] == 2.0
    given = np.ones((1, 1)), np.ones((1, 1)), np.full((1, 5, 1), 4.5), DT_S
    np.testing.assert_array_equal(roll_out_ode(again, *given), roll_out_ode(ode, *given))


def test_what_cannot_be_fitted_says_why() -> None:
    with pytest.raises(ValueError, match="needs four"):
        fit_ode(swing(3), np.eye(1), settings(), seed=0)
    with pytest.raises(ValueError, match=r"ode\.method"):
        settings(method="euler")
    with pytest.raises(ValueError, match=r"ode\.structure"):
        settings(structure="lagrangian")
    with pytest.raises(ValueError, match="final_fraction"):
        settings(final_fraction=0.0)
