"""Inputs that are held between samples are seen to be so where the sim's own recordings say it."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import solve_ivp

from lagsplat.config.compose import compose
from lagsplat.pipelines.diagnosis_inputs import DiagnosisInputs, open_diagnosis_inputs

HZ, LAST_S = 40.0, 0.5


def save(path: Path, seed: int, *, held: bool) -> str:
    """Write ten seconds of a linear oscillator under steps, held or drawn as slopes between samples."""
    rng = np.random.default_rng(seed)
    time = np.arange(400) / HZ
    u = np.repeat(rng.normal(size=20), int(LAST_S * HZ))
    state, rows = np.array([0.3, 0.0]), []
    for n in range(400):
        rows.append(state[0])
        ends = u[n], u[n] if held else u[min(n + 1, 399)]

        def rate(t: float, y: np.ndarray, ends: tuple[float, float] = ends) -> list[float]:
            now = ends[0] + (ends[1] - ends[0]) * t * HZ
            return [y[1], -30.0 * y[0] - 0.8 * y[1] + 12.0 * now]

        state = solve_ivp(rate, (0.0, 1.0 / HZ), state, rtol=1e-9, atol=1e-11).y[:, -1]
    pd.DataFrame({"t": time, "q0": rows, "u0": u}).to_csv(path, index=False)
    return str(path)


@pytest.fixture(params=[True, False], ids=["held", "drawn"])
def pair(request, tmp_path: Path) -> tuple[bool, DiagnosisInputs]:
    files = [save(tmp_path / f"{name}.csv", seed, held=request.param) for seed, name in enumerate("ab")]
    return request.param, open_diagnosis_inputs(*files, compose().diagnose)


def test_a_sim_is_told_with_held_inputs_only_where_that_is_truer(pair: tuple[bool, DiagnosisInputs]) -> None:
    held, found = pair
    assert found.hold == ("zoh" if held else None)
    assert found.sim.misfit < 1.5
    said = [one.text for one in found.checked.findings if one.check == "held inputs"]
    assert len(said) == held
