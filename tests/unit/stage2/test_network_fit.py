"""Networks that take over a polynomial law and are fitted to the same likelihood."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from lagsplat.chart.trajectory import EncodedTrajectory
from lagsplat.stage2.equilibrium import linearize_modes
from lagsplat.stage2.fit import fit_dynamics
from lagsplat.stage2.lagrangian import Floors, Lagrangian
from lagsplat.stage2.likelihood.multiple_shooting import fit_windows
from lagsplat.stage2.likelihood.network_fit import NetworkVector, fit_networks, linearize_law, project_law
from lagsplat.stage2.rollout import rollout
from tests.stage2_problems import form, random_lagrangian
from tests.unit.stage2.test_fit import DECAY_PER_S, FREQUENCY_HZ, config, oscillator


def bent_law() -> Lagrangian:
    """A polynomial law in one bent coordinate and another, with volumes of the second degree."""
    law = random_lagrangian(
        2, 1, 3, amount=0.0, terms="polynomial", potential_degree=4, input_degree=2, map_degree=2
    )
    generator = torch.Generator().manual_seed(1)
    with torch.no_grad():
        for part in (law.coordinates, law.energy):
            assert part is not None
            part.coefficients += 0.03 * torch.randn(part.coefficients.shape, generator=generator).double()
        assert law.energy is not None
        law.energy.input_coefficients[0, 2:] += torch.tensor([0.2, 0.1, -0.2]).double()
    law.longest_step = 0.5
    return law


def record(law: Lagrangian, frames: int = 240) -> EncodedTrajectory:
    """Its motion under a wandering input."""
    time_s = float(law.time_unit_s) * 0.3 * np.arange(frames)
    wander = np.sin(0.31 * np.arange(frames)) + np.sin(0.047 * np.arange(frames))
    inputs = (0.25 * (2.0 + wander))[:, None]
    q, v = torch.tensor([[[0.5, -0.3]], [[0.0, 0.0]]]).double()
    path, _ = rollout(law, q, v, torch.from_numpy(inputs[None]), dt_s=time_s[1])
    return EncodedTrajectory(path[0].numpy(), inputs, time_s, ((0, frames),))


def make_networks(law: Lagrangian, motion: EncodedTrajectory, **changes: object) -> Lagrangian:
    return Lagrangian(
        linearize_law(law, motion.inputs),
        form=form(**changes),
        floors=Floors(1e-3, 1e-3, 1e-3),
        time_unit_s=float(law.time_unit_s),
        seed=0,
        longest_step=law.longest_step,
        integrator="runge_kutta",
    )


def test_the_linearised_law_has_the_modes_and_the_equilibrium_of_the_law() -> None:
    law = bent_law()
    motion = record(law)
    mean = torch.from_numpy(motion.inputs.mean(axis=0))
    near = make_networks(law, motion, mass="constant", damping="constant", potential="quadratic")
    found, wanted = linearize_modes(near, mean), linearize_modes(law, mean)
    assert found.equilibrium == pytest.approx(wanted.equilibrium, abs=1e-3)
    assert found.frequency_hz == pytest.approx(wanted.frequency_hz, rel=1e-3)
    assert found.decay_per_s == pytest.approx(wanted.decay_per_s, rel=1e-3)
    assert float(torch.trace(near.mass(torch.zeros(1, 2).double())[0]).detach()) == pytest.approx(
        2.0, rel=1e-2
    )


def test_networks_learn_the_accelerations_of_a_law() -> None:
    law = bent_law()
    motion = record(law)
    networks = make_networks(law, motion)
    before = project_law(law, make_networks(law, motion), motion, iterations=1, seed=0)
    missed = project_law(law, networks, motion, iterations=5, seed=0)
    assert missed < 0.7 * before
    assert missed < 0.002
    assert networks.convex is not None
    assert networks.volume_net is not None
    for net in (networks.convex, networks.volume_net):
        head = net.head.detach()
        assert float(head.min()) >= 0.0
        assert float(head.max()) > 0.0


def test_the_likelihood_brings_networks_back_to_the_motion() -> None:
    """Projected on a law that is too stiff, they find the recorded frequency."""
    law = bent_law()
    motion = record(law)
    noise = 0.01 * np.random.default_rng(0).standard_normal(motion.latents.shape)
    measured = replace(motion, latents=motion.latents + noise)
    none = torch.zeros(1, dtype=torch.float64)
    solved = fit_windows(
        law, measured, motion, motion.segments, n=20, coupling=0.05, noise=np.full(2, 0.01),
        memory=np.zeros(2), iterations=10, least_gain=0.1, hold_law=True,
    )  # fmt: skip
    networks = make_networks(law, motion)
    project_law(law, networks, motion, iterations=10, seed=0)
    with torch.no_grad():
        networks.stiffness_factor *= 1.1
    wrong = linearize_modes(networks, none).frequency_hz
    fitted = fit_networks(networks, law, solved, iterations=15)
    right, found = linearize_modes(law, none).frequency_hz, linearize_modes(networks, none).frequency_hz
    assert abs(wrong[0] / right[0] - 1.0) > 0.03
    assert abs(found[0] / right[0] - 1.0) < 0.01
    assert fitted.rms == pytest.approx([0.01, 0.01], rel=0.15)


def test_gradients_of_the_likelihood_reach_every_weight_and_start() -> None:
    law = bent_law()
    motion = record(law, 60)
    networks = make_networks(law, motion)
    vector = NetworkVector(networks)
    assert len(vector.read()) == sum(p.numel() for p in networks.parameters())
    assert sum(low == 0.0 for low, _ in vector.list_bounds()) == 16 + 8  # one potential and one volume
    theta = vector.read()
    vector.write(theta + 0.01)
    torch.testing.assert_close(vector.read(), theta + 0.01)


def test_networks_find_frequency_and_decay() -> None:
    trajectory = oscillator(250, driven=True)
    settings = config(integrator="runge_kutta")
    shorter = replace(settings.likelihood, network_iterations=2)
    settings = replace(settings, start=replace(settings.start, source="likelihood"), likelihood=shorter)
    law, report = fit_dynamics(trajectory, np.eye(1), settings, 0, rest=np.zeros(1))
    assert law.form.terms == "networks"
    assert report.at_rest is not None
    assert report.at_rest.frequency_hz[0] == pytest.approx(FREQUENCY_HZ, rel=0.01)
    assert report.at_rest.decay_per_s[0] == pytest.approx(DECAY_PER_S, rel=0.1)
    assert report.scores["networks"] <= report.scores["projection"] < 0.05
    assert report.draws is None
