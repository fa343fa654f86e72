"""One effect at several places at once: friction in every joint, a lag of every actuator."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from lagsplat.diagnose.augmented.model import build_augmented
from lagsplat.diagnose.augmented.simulate import AppliedSignals, simulate_augmented
from lagsplat.diagnose.effects.base import DisturbanceHints, PlacedEffect
from lagsplat.diagnose.estimation.dataset import sample_operating_region
from lagsplat.diagnose.inference.model_selection import continue_fit, try_candidate
from lagsplat.diagnose.inference.placement import place_effects
from lagsplat.diagnose.inference.problem import EstimationProblem
from lagsplat.diagnose.inference.profile_likelihood import estimate_parameters
from lagsplat.diagnose.inference.score_test import score_test
from lagsplat.io.trajectory.trajectory import Trajectory
from tests.unit.diagnose.toys import contest, coupled, wave

MECHANISM = replace(coupled(), dry=np.zeros(2))
FRICTION = np.array([1.5, 0.6])  # accelerations of each coordinate alone
LAG_S = (0.04, 0.09)
NAMES = ("q0", "q1")


def film(force: Callable[[np.ndarray], np.ndarray], *, lag_s: tuple[float, float] = (0.0, 0.0)) -> Trajectory:
    """20 s of the coupled mechanism under two inputs, with a force by its velocity and late actuators."""
    model, times = MECHANISM, np.arange(1000) / 50.0
    waves = (wave(1), wave(2))

    def rate(t: float, x: np.ndarray) -> np.ndarray:
        command = np.array([one(t) for one in waves])
        u = np.where(np.array(lag_s) > 0.0, x[4:], command)
        q, v = x[None, :2], x[None, 2:4]
        a = model.acceleration(q, v, u[None])[0] + np.linalg.solve(model.mass_at(q)[0], force(x[2:4]))
        return np.concatenate([x[2:4], a, (command - u) / np.maximum(lag_s, 1e-9)])

    begin = [0.5, -0.4, 0.0, 0.0, *(one(0.0) for one in waves)]
    solved = solve_ivp(rate, (0.0, times[-1]), begin, t_eval=times, rtol=1e-7, atol=1e-9, max_step=0.02)
    q = solved.y[:2].T
    q = q + 0.01 * q.std(axis=0) * np.random.default_rng(0).standard_normal(q.shape)
    u = np.array([[one(t) for one in waves] for t in times])
    return Trajectory(time_s=times, q=q, u=u, q_names=NAMES, u_names=("u0", "u1"), source="film")


def offered(one: EstimationProblem, name: str) -> dict[str, PlacedEffect]:
    """One effect by where it acts."""
    found = place_effects(
        one.rollout_model, [DisturbanceHints((), ())] * 2, q_names=NAMES, u_names=("u0", "u1"), without=()
    )
    return {
        "everywhere" if offer.parts else f"{offer.location}": offer
        for offer in found
        if offer.effect.name == name
    }


def best(one: EstimationProblem, offer: PlacedEffect):
    """The fit of one effect."""
    plain = one.fit((), np.zeros(one.rollout_model.nuisance.size))
    lead = score_test(one, (), plain, [offer])[0]
    return continue_fit(one, try_candidate(one, (), [lead], starts=2))


def test_friction_in_both_joints_is_told_from_friction_in_one() -> None:
    heavy = np.diag(MECHANISM.inertia)
    seen = contest([film(lambda v: -FRICTION * heavy * np.tanh(v / 0.02))], model=MECHANISM)
    offers = offered(seen, "coulomb_friction")
    joint = offers["everywhere"]
    assert {offer.location for label, offer in offers.items() if label != "everywhere"} == {*NAMES, "q1 - q0"}
    fits = {label: best(seen, offer) for label, offer in offers.items()}
    misfit = {label: one.fit.misfit / seen.degrees_of_freedom for label, one in fits.items()}
    assert misfit.pop("everywhere") < 1.3
    assert min(misfit.values()) > 5.0
    told = estimate_parameters(seen, fits["everywhere"], joint, 2.0)
    assert [told[f"acceleration {q}"].value for q in NAMES] == pytest.approx(FRICTION, rel=0.1)
    assert [told[f"acceleration {q}"].unit for q in NAMES] == ["q0/s^2", "q1/s^2"]


def test_a_lag_of_both_actuators_is_told_from_a_lag_of_one() -> None:
    seen = contest([film(np.zeros_like, lag_s=LAG_S)], model=MECHANISM)
    fits = {label: best(seen, offer) for label, offer in offered(seen, "input_lag").items()}
    joint = fits.pop("everywhere")
    assert joint.fit.misfit / seen.degrees_of_freedom < 1.3
    assert min(one.fit.misfit for one in fits.values()) > 3.0 * joint.fit.misfit
    found = joint.name_parameters(joint.effects[0])
    assert [found[f"time_constant {u}"] for u in ("u0", "u1")] == pytest.approx(LAG_S, rel=0.05)


def test_the_sim_with_it_holds_each_place_by_itself() -> None:
    seen = contest([film(np.zeros_like)], model=MECHANISM)
    both = offered(seen, "coulomb_friction")["everywhere"]
    unknowns = [0.2, -6.0, 0.0, 0.3, -6.0, 0.0]
    x = np.concatenate([unknowns, np.zeros(seen.rollout_model.nuisance.size)])
    region = sample_operating_region(seen.rollout_model.dataset)
    joint = build_augmented(seen.rollout_model, [both], x, q_names=NAMES, u_names=("u0", "u1"), region=region)
    assert [one.location for one in joint.effects] == list(NAMES)
    drive = AppliedSignals(np.arange(200) * 0.02, np.ones((200, 2)))
    moved, _ = simulate_augmented(joint, drive, q=np.array([0.4, 0.1]))
    starts = np.array([0.4, 0.1, 0.0, 0.0])[None, None]
    assert np.isfinite(moved).all()
    alone = build_augmented(
        seen.rollout_model, both.parts, x, q_names=NAMES, u_names=("u0", "u1"), region=region
    )
    np.testing.assert_array_equal(moved, simulate_augmented(alone, drive, q=np.array([0.4, 0.1]))[0])
    first = replace(seen.windows, first=seen.windows.first[:1], length=seen.windows.length[:1])
    together = seen.rollout_model.roll_out([both], x[None], starts, first)[0]
    apart = seen.rollout_model.roll_out(both.parts, x[None], starts, first)[0]
    np.testing.assert_array_equal(together, apart)
