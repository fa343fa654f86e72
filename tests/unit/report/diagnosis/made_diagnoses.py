"""Diagnoses of a made recording: two oscillators, the second of which has dry friction that its sim lacks."""

from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np

from lagsplat.diagnose.core.result import (
    Block,
    Candidate,
    Diagnosis,
    FileAgreement,
    Gap,
    Interval,
    NextExperiments,
    Parameter,
    Suggestion,
)

OMEGA = 2.0 * np.pi / 1.2
FRICTION = 0.8
NOISE = 0.01
DT = 1.0 / 60.0


@dataclass(frozen=True)
class MadeMotion:
    time_s: np.ndarray
    q: np.ndarray
    u: np.ndarray
    segments: tuple[tuple[int, int], ...]
    source: str = "swing.csv"


@dataclass(frozen=True)
class MadeSmoothed:
    motion: MadeMotion
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    residual: np.ndarray
    std: np.ndarray


@dataclass(frozen=True)
class MadeSpectrum:
    frequency_hz: np.ndarray
    power: np.ndarray
    coherence: np.ndarray
    names: tuple[str, ...]
    significant: float
    bands: tuple[tuple[float, float, float], ...]
    lines: tuple[Any, ...] = ()


@dataclass(frozen=True)
class MadeMap:
    coordinate: int
    position_edges: np.ndarray
    velocity_edges: np.ndarray
    mean: np.ndarray
    score: np.ndarray


def path(state, n, *, friction):
    """A swing with dry friction on the second coordinate, (n, 2), by small semi-implicit steps."""
    q, v = state[0].copy(), state[1].copy()
    out = []
    for _ in range(n):
        out.append((q.copy(), v.copy()))
        for _ in range(20):
            dry = np.array([0.0, friction]) * np.tanh(v / 0.02)
            v = v + DT / 20 * (-(OMEGA**2) * q - 0.06 * OMEGA * v - dry)
            q = q + DT / 20 * v
    return np.array(out)[:, 0], np.array(out)[:, 1]


@cache
def blocks():
    rng = np.random.default_rng(0)
    n = round(2.0 * np.pi / OMEGA / DT)
    made = []
    for i in range(8):
        fade = np.exp(-0.25 * i)
        state = np.array([[0.6 * fade, 0.9 * fade], [0.4, -0.3]])
        real = path(state, n, friction=FRICTION)[0] + NOISE * rng.standard_normal((n, 2))
        sim, augmented = (path(state, n, friction=f)[0] for f in (0.0, FRICTION))
        made.append(Block("swing.csv", i, 2.4 * i + DT * np.arange(n), real, sim, augmented))
    return tuple(made)


def miss(kind):
    """Root mean square of the forecasts' errors over each coordinate's rms."""
    real = np.concatenate([one.real for one in blocks()])
    off = np.concatenate([getattr(one, kind) - one.real for one in blocks()])
    return float(np.sqrt(np.mean(off**2 / real.var(axis=0))))


def gap():
    before, after = miss("sim"), miss("augmented")
    floor = 0.9 * after
    refit = before - 0.2 * (before - floor)
    closed = (before - after) / (before - floor)
    closure = Interval(closed, closed - 0.06, min(closed + 0.02, 1.0))
    lost = {"before": 0, "refit": 0, "after": 0}
    return Gap(before, refit, after, floor, 1.2, closure, blocks=len(blocks()), diverged=lost)


@cache
def where():
    """As `lagsplat.diagnose` computes it, with arrays for figures."""
    rng = np.random.default_rng(1)
    parts, v_parts = zip(
        *(path(np.array([[0.6, 0.9 * f], [0.4, -0.3]]), 600, friction=FRICTION) for f in (1.0, 0.7)),
        strict=True,
    )
    q, v = np.concatenate(parts), np.concatenate(v_parts)
    time_s = np.concatenate([DT * np.arange(600), 12.0 + DT * np.arange(600)])
    residual = np.stack([0.03 * np.sin(time_s), -FRICTION * np.tanh(v[:, 1] / 0.1)], axis=1)
    residual += 0.05 * np.convolve(rng.standard_normal(1200), np.ones(20) / 20, mode="same")[:, None]
    motion = MadeMotion(time_s, q, np.zeros((1200, 1)), ((0, 600), (600, 1200)))
    smoothed = MadeSmoothed(motion, q, v, np.gradient(v, DT, axis=0), residual, np.full((1200, 2), 0.08))
    f = np.linspace(0.05, 8.0, 300)
    power = np.stack([1e-4 + 0 * f, 1e-3 + 0.2 / (1 + ((f - 1 / 1.2) / 0.05) ** 2)], axis=1)
    coherence = np.clip(rng.uniform(0, 0.3, (300, 2, 3)), 0, 1)
    coherence[:, 1, 2] = np.exp(-(((f - 1 / 1.2) / 0.3) ** 2))
    return {
        "level": "dynamics",
        "coordinates": {"q0": 0.04, "q1": 0.96},
        "time_s": (("swing.csv", 1.0, 4.5, 0.4), ("swing.csv", 12.5, 14.0, 0.2)),
        "frequency_hz": ((0.7, 1.0, 0.8),),
        "state_region": {"q1": [{"position": [-0.5, 0.5], "velocity": [0.1, 3.0], "mean": -0.8}]},
        "image_region": None,
        "components": {
            "inertial": 0.02,
            "conservative": 0.05,
            "dissipative": 0.83,
            "actuation": 0.0,
            "exogenous": 0.01,
            "memory": 0.03,
            "unexplained": 0.06,
        },
        "evidence": {"q0": 0.3, "q1": 212.0},
        "smoothed": (smoothed,),
        "spectrum": MadeSpectrum(f, power, coherence, ("u0", "v_q0", "v_q1"), 0.5, ((0.7, 1.0, 0.8),)),
        "maps": (state_map(q[:, 1], v[:, 1], residual[:, 1]),),
    }


def state_map(q, v, residual, bins=8):
    edges = [np.linspace(x.min(), x.max(), bins + 1) for x in (q, v)]
    at = [
        np.clip(np.searchsorted(e, x, side="right") - 1, 0, bins - 1)
        for e, x in zip(edges, (q, v), strict=True)
    ]
    flat = np.ravel_multi_index(at, (bins, bins))
    count = np.bincount(flat, minlength=bins * bins)
    with np.errstate(invalid="ignore"):
        mean = (np.bincount(flat, residual, minlength=bins * bins) / count).reshape(bins, bins)
    return MadeMap(1, edges[0], edges[1], mean, np.nan_to_num(mean) * np.sqrt(count).reshape(bins, bins))


FITS = {
    "coulomb_friction": {"acceleration": Parameter(0.8012, 0.7713, 0.8321, "q1/s^2")},
    "stribeck_friction": {
        "coulomb": Parameter(0.78, 0.7, 0.84, "q1/s^2"),
        "static": Parameter(0.85, 0.79, 1.4, "q1/s^2"),
        "velocity": Parameter(0.012, 0.002, 0.2, "q1/s"),
    },
    "viscous_damping": {"rate": Parameter(0.212, 0.181, 0.243, "1/s")},
    "linear_stiffness": {"ratio": Parameter(1.1234, 1.1102, 1.1371, "1")},
    "input_delay": {"delay": Parameter(0.0832, 0.0711, 0.0954, "s")},
    "external_push": {
        "times": Parameter([3.21, 7.4], [3.1, 7.3], [3.3, 7.5], "s"),
        "accelerations": Parameter([2.1, -1.3], [1.9, -1.5], [2.3, -1.1], "q1/s^2"),
    },
    "time_offset": {"offset": Parameter(-0.041, -0.052, -0.029, "s")},
    "quadratic_drag": {"coefficient": Parameter(0.1, 0.05, 0.15, "1/q1")},
    "hysteresis": {
        "acceleration": Parameter(0.7, 0.5, 0.9, "q1/s^2"),
        "displacement": Parameter(0.02, 0.005, 0.1, "q1"),
    },
    "none": {},
    "unknown": {},
}


def candidates(**chances):
    """Candidates of these probabilities, the most probable first."""
    made = []
    for name, chance in sorted(chances.items(), key=lambda row: -row[1]):
        named = name not in ("none", "unknown")
        of_input = name.startswith("input")
        made.append(
            Candidate(
                name=name,
                probability=chance,
                coordinate="q1" if named and not of_input and name != "time_offset" else None,
                input="u0" if of_input else None,
                parameters=FITS[name],
                closure=Interval(0.9 * chance, 0.8 * chance, chance) if named else None,
                log_evidence=0.0 if name == "none" else float(60.0 + 20.0 * np.log(chance + 1e-3)),
                misfit=1.02 if named else None,
            )
        )
    return tuple(made)


def checks():
    rows = [
        ("coulomb_friction", "yes", 0.19, ""),
        ("stribeck_friction", "weak", 1.26, "slow reversals"),
        ("viscous_damping", "yes", 0.11, ""),
        ("input_lag", "no", None, "steps of the input, or fast swings"),
        ("input_delay", "no", None, "steps of the input, or fast swings"),
        ("end_stop", "weak", 1.12, "three speeds into the end"),
    ]
    return {
        "period_s": 1.2,
        "periods": 16.4,
        "noise": {"q0": 0.011, "q1": 0.0098},
        "blocks": 16,
        "findings": [
            {
                "level": "warn",
                "check": "cut",
                "source": "swing.csv",
                "what": "the motion jumps by 0.3 at 10 s",
                "why": "nothing can be continued across it",
                "remedy": "write a column segment",
                "columns": ["q1"],
            }
        ],
        "excitation": [
            dict(zip(("effect", "excited", "smallest", "record"), row, strict=True)) for row in rows
        ],
    }


def base(verdict, fits, combination=(), **more):
    made = Diagnosis(
        verdict=verdict,
        candidates=fits,
        combination=combination,
        gap=gap(),
        where=where(),
        equivalent=(),
        excitation=("let it go from a large deflection and record 12 s, until it is at rest",),
        warnings=("swing.csv: the motion jumps by 0.3 at 10 s.",),
        absorbed=(),
        blocks=blocks(),
        checks=checks(),
        q_names=("q0", "q1"),
        u_names=("u0",),
    )
    return replace(made, **more)


def friction():
    fits = candidates(coulomb_friction=0.997, viscous_damping=0.001, none=0.0005, unknown=0.0015)
    return base("effect", fits, ("coulomb_friction",))


def every_kind():
    """A diagnosis of every verdict and kind of cause, by name."""
    alike = candidates(coulomb_friction=0.5, stribeck_friction=0.35, hysteresis=0.05, none=0.04, unknown=0.06)
    two = candidates(coulomb_friction=0.9, input_delay=0.04, quadratic_drag=0.03, none=0.01, unknown=0.02)
    open_ = candidates(coulomb_friction=0.4, quadratic_drag=0.3, none=0.2, unknown=0.1)
    bare = {"level": "dynamics", "coordinates": {"q0": 0.1, "q1": 0.9}}
    return {
        "single": friction(),
        "combination": base("effect", two, ("coulomb_friction", "input_delay")),
        "class": base(
            "effect", alike, ("coulomb_friction",), equivalent=(("coulomb_friction", "stribeck_friction"),)
        ),
        "undecided": base("effect", open_, ("coulomb_friction",)),
        "parameter": base(
            "effect", candidates(linear_stiffness=0.95, none=0.03, unknown=0.02), ("linear_stiffness",)
        ),
        "observation": base(
            "effect",
            candidates(time_offset=0.7, input_delay=0.2, none=0.05, unknown=0.05),
            ("time_offset",),
            where=where() | {"level": "actuation"},
        ),
        "push": base(
            "effect", candidates(external_push=0.92, none=0.04, unknown=0.04), ("external_push",), where=bare
        ),
        "none": base(
            "none",
            candidates(none=0.96, coulomb_friction=0.03, unknown=0.01),
            gap=Gap(0.052, 0.051, 0.051, 0.05, 1.2, Interval(None, None, None)),
        ),
        "unknown": base("unknown", candidates(unknown=0.9, coulomb_friction=0.08, none=0.02)),
        "undetermined": base(
            "undetermined",
            candidates(none=0.4, unknown=0.35, coulomb_friction=0.25),
            gap=None,
            where=None,
            blocks=(),
            checks=checks() | {"undetermined": "the recording lasts only 1.4 periods"},
        ),
    }


def planned():
    """One experiment with inputs and one without."""
    first = Suggestion(
        kind="chirp",
        text="Record a chirp of torque, for 12 s",
        duration_s=12.0,
        nats=7.5,
        low=3.0,
        high=9.0,
        repeats=1,
        coordinate="q1",
        time_s=4.25,
        expected=(0.5, 0.25),
        start={"q0": 0.0, "q1": 0.5},
        input={"t": np.arange(3) * DT, "torque": np.array([0.0, 0.5, 1.0])},
    )
    release = replace(first, kind="release", text="Release it", input={"t": np.arange(3) * DT})
    return NextExperiments(("Coulomb friction (q1)", "viscous damping (q1)"), (first, release))


def several_files():
    """Two files that agree and one that does not."""
    agree = [FileAgreement(f"swing_{i}.csv", 0.2, 0.05, 0.04, 9, -4.5, "coulomb_friction") for i in (0, 1)]
    state = "another state of the mechanism: acceleration 0.9 instead of 0.5"
    return (*agree, FileAgreement("swing_2.csv", 0.3, 0.15, 0.04, 8, 31.0, "coulomb_friction", state))
