"""The arm once more, under other pressures and with an effect that a sim of the first recording lacks."""

from dataclasses import asdict, replace
from typing import no_type_check

import numpy as np
from jaxtyping import Float64
from numba import njit
from scipy.integrate import solve_ivp
from scipy.signal import lsim, lti

from lagsplat.io.files.atomic import sha256_of_arrays
from lagsplat.io.recording.recording import Recording
from lagsplat.systems import chain
from lagsplat.systems.arm import Arm, build_arm
from lagsplat.systems.config import PlantedConfig, SimulationConfig
from lagsplat.systems.release import draw_pressures, spline_coefficients
from lagsplat.systems.rendering.painting import paint_board
from lagsplat.systems.simulate import choose_rate, film_simulation

CREEP_RAD_S = 0.05
"""Bending rate from which on dry friction is nearly whole; below, it is viscous and can be integrated."""


def simulate_planted(config: SimulationConfig, planted: PlantedConfig, *, seed: int, scene: int) -> Recording:
    """A recording of the arm with the effect, before the background of the recording of seed ``scene``.

    Its inputs are the pressures that were asked for, with the gauge's noise; what a lag makes of them is
    withheld, and so is all else that was planted.

    Raises:
        ValueError, RuntimeError: the arm has no rest pose, or is driven out of its physical range.
    """
    drive, gauge, camera = (np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(3))
    painter = np.random.default_rng(np.random.SeedSequence(scene).spawn(4)[3])
    loads = [*config.arm.link_mass[:-1], config.arm.link_mass[-1] + planted.tip_mass]
    arm = build_arm(replace(config.arm, link_mass=loads))
    asked = draw_pressures(config, generator=drive)
    felt = lag_input(asked, lag_s=planted.actuator_lag_s, dt_s=config.dt_s)
    states = _move(arm, felt, planted, config)
    board = paint_board(
        height=config.height, width=config.width, arm_share=config.arm.half_width / config.view_width,
        generator=painter,
    )  # fmt: skip
    frames = film_simulation(states, arm=arm, board=board, config=config, generator=camera)
    inputs = asked + config.pressure_noise_atm * gauge.standard_normal(asked.shape)
    n_u = asked.shape[1]
    return Recording(
        frames=frames,
        time_s=np.arange(config.n_frames) * config.dt_s,
        inputs=inputs,
        input_names=tuple(f"p{i + 1}" for i in range(n_u)),
        input_units=("atm",) * n_u,
        meta={
            "origin": "simulated",
            "source": f"lagsplat.systems.injected_effects, {n_u // 2} segment(s), seed {seed}",
            "sha256": sha256_of_arrays(frames, inputs),
            "licence": "BSD-3-Clause",
            "simulation": asdict(config),
            "planted": asdict(planted),
            "seed": seed,
        },
    )


def lag_input(
    pressures: Float64[np.ndarray, "T n_u"], *, lag_s: float, dt_s: float
) -> Float64[np.ndarray, "T n_u"]:
    """Pressures behind a first-order lag, exact where they are straight between frames; zero lag is none."""
    if lag_s == 0.0:
        return pressures
    times = dt_s * np.arange(len(pressures))
    columns = [lsim(lti([1.0], [lag_s, 1.0]), column, times)[1] for column in pressures.T]
    return np.stack(columns, axis=1)


@njit(cache=True)
@no_type_check
def _rate(t, state, spline, dt_s, friction, table, nodes, weights, gravity):
    d = state.size // 2
    q, v = state[:d], state[d:]
    out = choose_rate(t, state, spline, dt_s, table, nodes, weights, gravity)
    rubbing = -friction * np.tanh(v / CREEP_RAD_S)
    out[d:] += np.linalg.solve(chain.chain_inertia(q, v, table, nodes, weights, gravity)[0], rubbing)
    return out


def _move(
    arm: Arm, pressures: Float64[np.ndarray, "T n_u"], planted: PlantedConfig, config: SimulationConfig
) -> Float64[np.ndarray, "T d"]:
    """States at the frames; the arm hangs at rest until the first pressure."""
    rest, start = arm.equilibrium(np.zeros(arm.d)), config.rest_frames
    friction = np.zeros(arm.d)
    friction[0::2] = planted.dry_friction * arm.table[:, chain.K_BEND]
    spline = spline_coefficients(pressures[start:], dt_s=config.dt_s)
    times = np.arange(len(pressures) - start) * config.dt_s
    solution = solve_ivp(
        _rate, (0.0, times[-1]), np.concatenate([rest, np.zeros(arm.d)]), method="DOP853", t_eval=times,
        rtol=config.rtol, atol=config.atol, max_step=3 * config.dt_s,
        args=(spline, config.dt_s, friction, arm.table, arm.nodes, arm.weights, arm.gravity),
    )  # fmt: skip
    if not solution.success or not np.all(np.isfinite(solution.y)):
        raise RuntimeError(
            f"integration of the arm stopped at t = {solution.t[-1]:.3f} s ({solution.message}): what was "
            "planted takes it out of its physical range; lower planted.effects"
        )
    return np.concatenate([np.tile(rest, (start, 1)), solution.y[: arm.d].T])
