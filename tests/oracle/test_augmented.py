"""Augmented sims: simulated as scipy would, kept and read back, pushed, and moved to another sim."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import solve_ivp

from lagsplat.cli.main import main
from lagsplat.diagnose.augmented.model import (
    AugmentedSimulator,
    load_augmented,
    save_augmented,
    transfer_effects,
)
from lagsplat.diagnose.augmented.simulate import AppliedSignals, simulate_augmented
from lagsplat.diagnose.effects.base import Direction, PlacedEffect
from lagsplat.diagnose.effects.parameters import Scales
from lagsplat.diagnose.effects.registry import catalogue
from lagsplat.diagnose.estimation.dataset import OperatingRegion
from lagsplat.diagnose.estimation.nuisance import NuisanceParameters
from lagsplat.diagnose.mechanics.basis import make_polynomial_basis
from lagsplat.diagnose.mechanics.model import MechanicalModel
from lagsplat.io.files.artifact import read_header
from lagsplat.io.files.atomic import save_json
from lagsplat.pipelines.apply_diagnosis import apply_diagnosis
from tests.unit.diagnose.toys import bare

STIFF, DAMPED, GAIN = 40.0, 0.4, 12.0
RUBBING = [0.1, -6.0, 0.0]  # unknowns of Coulomb friction
SCALES = Scales(coordinate=0.5, velocity=3.0, reach=1.0, frame_s=0.01, duration_s=10.0)


def oscillator() -> MechanicalModel:
    """``a = -40 q - 0.4 v + 12 u``, the potential's slope as that of a quadratic about 0.1."""
    basis = make_polynomial_basis(2, centre=np.array([0.1]), scale=np.ones(1))
    return MechanicalModel(
        basis=basis,
        mass=np.ones((1, 1, 1)),
        damping=np.full((1, 1, 1), DAMPED),
        potential=np.array([0.0, 0.1 * STIFF, 0.5 * STIFF]),
        input_map=np.full((1, 1, 1), GAIN),
        dry=np.zeros(1),
        drag=np.zeros(1),
        width=np.ones(1),
        rest=np.zeros(1),
    )


def sim(*effects: tuple[str, list[float]], model: MechanicalModel | None = None) -> AugmentedSimulator:
    """The oscillator with effects of the catalogue and their unknowns."""
    region = OperatingRegion(*(np.zeros((3, 1)) for _ in range(3)))
    one = bare(model or oscillator(), region, step_s=0.002, dt_s=0.01)
    along = Direction("q0", np.ones(1), 1.0)
    known = catalogue()
    placed = tuple(
        PlacedEffect(known[name], SCALES, direction=along, channel=0 if name.startswith("input") else None)
        for name, _ in effects
    )
    return replace(one, effects=placed, x=np.concatenate([*(x for _, x in effects), one.x]))


def uneven() -> AppliedSignals:
    rng = np.random.default_rng(0)
    time = np.cumsum(rng.uniform(0.002, 0.03, 250))
    return AppliedSignals(time, np.sin(9.0 * time)[:, None])


def reference(
    drive: AppliedSignals, *, held: bool, start: tuple[float, float], extra=lambda t, q, v: 0.0
) -> np.ndarray:
    """Interval by interval, so that no step of the solver straddles a kink of the input."""
    u, state, out = drive.u[:, 0], list(start), [start[0]]
    for n, (a, b) in enumerate(zip(drive.time_s[:-1], drive.time_s[1:], strict=True)):

        def rate(t: float, x: np.ndarray, n: int = n, a: float = a, b: float = b) -> list[float]:
            push = u[n] if held else u[n] + (u[n + 1] - u[n]) * (t - a) / (b - a)
            return [x[1], -STIFF * x[0] - DAMPED * x[1] + GAIN * push + extra(t, x[0], x[1])]

        state = solve_ivp(rate, (a, b), state, rtol=1e-9, atol=1e-10).y[:, -1]
        out.append(state[0])
    return np.array(out)


@pytest.mark.parametrize("held", [False, True])
def test_a_bare_sim_moves_as_scipy_says(held: bool) -> None:
    drive = uneven()
    q, v = simulate_augmented(sim(), drive, q=np.array([0.3]), v=np.array([-1.0]), held=held)
    np.testing.assert_allclose(q[:, 0], reference(drive, held=held, start=(0.3, -1.0)), atol=2e-6)
    np.testing.assert_allclose(v[0], [-1.0])


def test_an_effect_moves_as_its_equation_says() -> None:
    drive = uneven()
    drag, coefficient = 0.6, 7.0
    one = sim(
        ("quadratic_drag", [drag / SCALES.of("per_coordinate")]),
        ("cubic_stiffness", [coefficient / SCALES.of("cubic")]),
    )
    q, _ = simulate_augmented(one, drive, q=np.array([0.5]))

    def extra(t: float, q: float, v: float) -> float:
        return -drag * abs(v) * v - coefficient * q**3

    np.testing.assert_allclose(
        q[:, 0], reference(drive, held=False, start=(0.5, 0.0), extra=extra), atol=1e-4
    )
    assert one.parameters(1) == {"coefficient": pytest.approx(coefficient)}


def moved() -> AugmentedSimulator:
    """With effects of every kind and with uncertainties that a diagnosis has moved."""
    one = sim(
        ("input_delay", [0.3]), ("coulomb_friction", RUBBING), ("creep", [0.2, 0.1]), ("time_offset", [-0.1])
    )
    size = one.nuisance.directions.shape[1]
    spare = NuisanceParameters(
        0.01, 0.02, 0.03, 0.04, np.array([0.5]), 0.04, 1, np.linspace(-0.1, 0.1, size)[None]
    )
    own = len(one.x) - one.nuisance.size
    return replace(one, nuisance=spare, x=np.concatenate([one.x[:own], [0.01, 0.1, -0.02, 0.3, 0.01, 0.5]]))


def test_a_file_gives_the_same_sim_again(tmp_path: Path) -> None:
    one, drive = moved(), uneven()
    save_augmented(tmp_path / "a.safetensors", one, {"config": 1})
    read = load_augmented(tmp_path / "a.safetensors")
    for a, b in zip(simulate_augmented(one, drive), simulate_augmented(read, drive), strict=True):
        np.testing.assert_array_equal(a, b)
    assert np.ptp(simulate_augmented(one, drive)[0]) > 0.1
    header = read_header(tmp_path / "a.safetensors", kind="augmented")
    assert header["augmented"]["effects"][0]["parameters"] == {
        "delay": pytest.approx(np.exp(0.3) * 0.5 / 3.0)
    }


def test_a_push_is_an_acceleration_and_no_effect_touches_it() -> None:
    drive = uneven()
    push = np.where(drive.time_s > 1.0, 3.0, 0.0)[:, None]
    steady = sim(("constant_force", [1.5 / SCALES.of("acceleration")]))
    np.testing.assert_allclose(
        simulate_augmented(sim(), replace(drive, push=np.full_like(drive.u, 1.5)))[0],
        simulate_augmented(steady, drive)[0],
        atol=1e-9,
    )
    np.testing.assert_allclose(
        simulate_augmented(moved(), replace(drive, push=0.0 * push))[0],
        simulate_augmented(moved(), drive)[0],
        rtol=0.0,
        atol=1e-12,
    )
    # the delayed inputs come late, the push does not
    quiet = replace(drive, u=0.0 * drive.u)
    late = sim(("input_delay", [3.0]), ("time_offset", [1.0]))
    np.testing.assert_allclose(
        simulate_augmented(late, replace(quiet, push=push))[0],
        simulate_augmented(sim(), replace(quiet, push=push))[0],
        atol=1e-12,
    )


def test_effects_are_grafted_on_another_sim() -> None:
    heavier = replace(oscillator(), mass=np.full((1, 1, 1), 2.0))
    one = transfer_effects(moved(), heavier)
    assert one.effects[1].direction is not None
    assert one.effects[1].direction.inertia == pytest.approx(2.0)
    bare_moved = replace(moved(), effects=(), x=np.zeros(6))
    assert (
        np.abs(simulate_augmented(one, uneven())[0] - simulate_augmented(bare_moved, uneven())[0]).max()
        > 0.01
    )
    assert one.parameters(1) == moved().parameters(1)
    doubled = replace(oscillator(), input_map=np.ones((1, 2, 1)))
    with pytest.raises(ValueError, match="1 input"):
        transfer_effects(moved(), doubled)


def test_the_command_line_simulates_and_applies(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    kept, out = tmp_path / "augmented.safetensors", tmp_path / "q.csv"
    save_augmented(kept, moved(), {})
    drive = uneven()
    table = pd.DataFrame({"t": drive.time_s, "u0": drive.u[:, 0], "f0": 0.5})
    table.to_csv(tmp_path / "u.csv", index=False)
    words = ["simulate", f"run={kept}", f"input={tmp_path / 'u.csv'}", f"out={out}", "initial=0.2,-1"]
    assert main([*words, "input_hold=zoh"]) == 0
    got = pd.read_csv(out)
    assert list(got) == ["t", "q0", "v0"]
    expected = simulate_augmented(
        moved(),
        replace(drive, push=np.full_like(drive.u, 0.5)),
        q=np.array([0.2]),
        v=np.array([-1.0]),
        held=True,
    )
    np.testing.assert_allclose(got[["q0", "v0"]], np.concatenate(expected, axis=1), atol=1e-9)
    assert main(["simulate", f"run={kept}", "seconds=1", f"out={out}"]) == 0
    assert len(pd.read_csv(out)) == 100

    save_json(tmp_path / "diagnosis.json", {"verdict": "effect"})
    again = tmp_path / "again.safetensors"
    assert main(["apply", f"diagnosis={tmp_path / 'diagnosis.json'}", f"out={again}"]) == 0
    np.testing.assert_array_equal(
        simulate_augmented(load_augmented(again), drive)[0], simulate_augmented(moved(), drive)[0]
    )
    capsys.readouterr()
    for wrong, reason in (
        (["initial=0.1,0.2,0.3"], "3 number(s)"),
        (["initial=gone.csv"], "gone.csv"),
        (["input_hold=maybe"], "choose linear or zoh"),
        (["frame=3"], "not 'frame=3'"),
        (["seconds=2", "input=u.csv"], "exclude each other"),
    ):
        assert main(["simulate", f"run={kept}", f"out={tmp_path / 'no.csv'}", *wrong]) == 2
        assert reason in capsys.readouterr().err


def test_apply_adds_the_effects_to_a_sim_of_python(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    region = OperatingRegion(*(rng.uniform(-1.0, 1.0, (300, 1)) for _ in range(3)))
    one = replace(sim(("coulomb_friction", RUBBING)), region=region)
    save_augmented(tmp_path / "augmented.safetensors", one, {})
    save_json(tmp_path / "diagnosis.json", {"verdict": "effect"})
    (tmp_path / "mine.py").write_text("def rates(q, v, u):\n    return -40.0 * q - 0.4 * v + 12.0 * u\n")
    made = apply_diagnosis(
        tmp_path / "diagnosis.json", f"{tmp_path / 'mine.py'}:rates", out=tmp_path / "b.safetensors"
    )
    np.testing.assert_allclose(
        simulate_augmented(made, uneven())[0], simulate_augmented(one, uneven())[0], atol=1e-5
    )
    (tmp_path / "real.csv").write_text("t,q0\n0,0\n1,1\n")
    with pytest.raises(ValueError, match="leave sim= out"):
        apply_diagnosis(
            tmp_path / "diagnosis.json", str(tmp_path / "real.csv"), out=tmp_path / "c.safetensors"
        )
    (tmp_path / "alone").mkdir()
    save_json(tmp_path / "alone" / "diagnosis.json", {"verdict": "none"})
    with pytest.raises(FileNotFoundError, match="or diagnose again"):
        apply_diagnosis(tmp_path / "alone" / "diagnosis.json", None, out=tmp_path / "c.safetensors")


def test_a_drive_that_does_not_fit_is_refused() -> None:
    drive = uneven()
    with pytest.raises(ValueError, match=r"2 input column\(s\), but the sim has 1: u0"):
        simulate_augmented(sim(), replace(drive, u=np.zeros((250, 2))))
    with pytest.raises(ValueError, match="2 column"):
        simulate_augmented(sim(), replace(drive, push=np.zeros((250, 2))))
    with pytest.raises(ValueError, match="initial state"):
        simulate_augmented(sim(), drive, q=np.zeros(2))
    with pytest.raises(ValueError, match="times that increase"):
        simulate_augmented(sim(), replace(drive, time_s=drive.time_s[::-1]))
