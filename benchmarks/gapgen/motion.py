"""Motion of a mechanism with its withheld effects, clip by clip, and what a camera and a clock make of it."""

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from benchmarks.gapgen import laws
from benchmarks.gapgen.effect import Effect
from benchmarks.gapgen.inputs import on_half_steps, through_actuator
from benchmarks.gapgen.integrate import forecasts, run
from benchmarks.gapgen.mechanisms import Mechanism
from benchmarks.gapgen.payloads import load

Array = NDArray[np.float64]
SHARP = (laws.FRICTION, laws.BRISTLE, laws.STOP)
CORNERED = (
    laws.SLIP_CHAIN,
    laws.FREE_PLAY,
    laws.SWITCH,
    laws.ONE_WAY,
    laws.LIP_SEAL,
    laws.BELT,
    laws.MOTOR,
)
BURN = 10


@dataclass(frozen=True)
class Plan:
    """How a recording is driven: per clip the start time, initial state (2 d,), lead samples and inputs.

    ``inputs`` (lead + n, n_u) begin ``lead`` samples before the clip; what happens there is not recorded.
    """

    dt_s: float
    start_s: list[float]
    x0: list[Array]
    lead: list[int]
    inputs: list[Array]


@dataclass
class Clip:
    """One clip as it truly moved: ``t0`` its start, ``x`` (n, n_x) states, ``fine`` inputs at half steps."""

    t0: float
    x: Array
    fine: Array
    n_sub: int
    u: Array


@dataclass
class World:
    """A mechanism and its effects in the form the integrator takes."""

    operators_of_model: ClassVar[tuple[str, ...]] = ()
    """Operators on inputs that the mechanism's own model holds."""

    mechanism: Mechanism
    effects: list[Effect] = field(default_factory=list)

    def __post_init__(self) -> None:
        rows = [row for effect in self.effects for row in effect.rows]
        self.which = np.zeros((len(rows), 4), np.int64)
        self.how = np.zeros((len(rows), laws.WIDTH))
        self.n_z = 0
        for e, (law, i, j, numbers) in enumerate(rows):
            self.which[e] = law, i, self.n_z, j
            self.how[e, : len(numbers)] = numbers
            self.n_z += laws.n_states(law)
        self.loaded = self._load()
        self.inertia = np.diag(self.mechanism.inertia_at_rest()).copy()
        stiffness = np.diag(self.mechanism.stiffness_at_rest())
        self.own_hz = np.sqrt(stiffness / self.inertia) / (2.0 * np.pi)
        self.top_hz = float(self.mechanism.frequencies_hz()[-1])
        for effect in self.effects:
            self.top_hz = max([self.top_hz, *effect.frequency_hz])

    def _load(self) -> Mechanism:
        return load(self.mechanism, self.effects)

    def n_sub(self, dt_s: float) -> int:
        """Integration steps in a sample."""
        step = (4e-3 if self.effects else 8e-3) / self.top_hz
        for law, i, _, _ in self.which:
            if law in SHARP:
                step = min(step, 4e-4 / self.own_hz[i])
            elif law in CORNERED:
                step = min(step, 1e-3 / self.own_hz[i])
        return max(2, int(np.ceil(dt_s / step)))

    def state(self, x0: Array) -> Array:
        """A state with internal states at what a long hold at ``x0`` (2 d,) leaves."""
        x = np.concatenate([x0, np.zeros(self.n_z)])
        at = len(x0)
        for (law, i, z, _), th in zip(self.which, self.how, strict=True):
            if law == laws.CREEP:
                x[at + z : at + z + 2] = x0[i]
            elif law == laws.FRACTIONAL:
                x[at + z : at + z + laws.BRANCHES] = x0[i]
            elif law == laws.ABSORBER:
                x[at + z] = x0[i]
            elif law == laws.SLIP_CHAIN:
                limits = np.array([laws.slider_limit(th, k) for k in range(laws.SLIDERS)])
                x[at + z : at + z + laws.SLIDERS] = np.clip(x0[i], -limits, limits)
        return x

    def drive(self, u: Array, dt_s: float, n_sub: int) -> Array:
        """What the inputs (T, n_u) have become where they act, at half steps."""
        fine = on_half_steps(u, n_sub)
        for effect in self.effects:
            for j, name, numbers in effect.operators:
                if name not in self.operators_of_model:
                    fine[:, j] = through_actuator(fine[:, j].copy(), name, numbers, 0.5 * dt_s / n_sub)
        return fine

    def move(self, plan: Plan) -> list[Clip]:
        """The clips of a plan.

        Raises:
            FloatingPointError: if a motion leaves every bound.
        """
        m = self.mechanism
        n_sub = self.n_sub(plan.dt_s)
        clips = []
        for t0, x0, lead, u in zip(plan.start_s, plan.x0, plan.lead, plan.inputs, strict=True):
            fine = self.drive(u, plan.dt_s, n_sub)
            x = self._run(self.state(x0), t0 - lead * plan.dt_s, plan.dt_s, len(u), n_sub, fine)
            if not np.isfinite(x).all() or np.abs(x[:, : m.d] / m.size).max() > 12.0:
                raise FloatingPointError("the motion left every bound")
            clips.append(Clip(t0, x[lead:], fine[2 * n_sub * lead :], n_sub, u[lead:]))
        return clips

    def _run(self, x0: Array, t0: float, dt_s: float, n: int, n_sub: int, fine: Array) -> Array:
        """States (n, n_x) at ``t0 + k dt_s`` from ``x0``."""
        m = self.loaded
        return run(m.kind, m.p, m.b, self.inertia, self.which, self.how, x0, t0, dt_s, n, n_sub, fine)

    def _forecasts(
        self,
        x0: Array,
        starts: NDArray[np.int64],
        t0: float,
        dt_s: float,
        burn: int,
        n: int,
        n_sub: int,
        fine: Array,
        y: Array,
    ) -> Array:
        """Forecasts (n_blocks, n, d) of the samples ``y`` of a clip from first guesses (n_blocks, n_x)."""
        m = self.loaded
        own = (m.kind, m.p, m.b, self.inertia, self.which, self.how)
        return forecasts(*own, x0, starts, t0, dt_s, burn, n, n_sub, fine, y)

    def forecast(
        self, clips: list[Clip], ys: list[Array], dt_s: float, n: int, most: int, burn: int = BURN
    ) -> list[tuple]:
        """Forecasts of ``n`` samples from the first ``burn`` of every block.

        One (clip, starts, (k, n, d)) for every clip that holds a block.

        ``clips`` give inputs and, where they hold them, internal states; ``ys`` (T, d) the samples.
        """
        d = self.mechanism.d
        total = sum(max((len(y) - n) // (n - burn) + 1, 0) for y in ys)
        stride = (n - burn) * max(1, int(np.ceil(total / most)))
        n_sub = self.n_sub(dt_s)
        out = []
        for k, (clip, y) in enumerate(zip(clips, ys, strict=True)):
            starts = np.arange(0, len(y) - n + 1, stride)
            if not len(starts):
                continue
            # internal states of the effects that both have are the first
            z = np.zeros((len(starts), self.n_z))
            known = clip.x[starts, 2 * d : 2 * d + self.n_z]
            z[:, : known.shape[1]] = known
            x0 = np.concatenate([y[starts], _slope(y, starts, dt_s, burn), z], 1)
            fine = clip.fine if self.effects and clip.n_sub == n_sub else self.drive(clip.u, dt_s, n_sub)
            out.append((k, starts, self._forecasts(x0, starts, clip.t0, dt_s, burn, n, n_sub, fine, y)))
        return out


def _slope(y: Array, starts: NDArray[np.int64], dt_s: float, burn: int) -> Array:
    t = (np.arange(burn) - 0.0) * dt_s
    design = np.column_stack([np.ones(burn), t, t**2])
    weight = np.linalg.pinv(design)[1]
    return np.stack([weight @ y[a : a + burn] for a in starts])


def gap(forecast: list[tuple], ys: list[Array], rms: Array, burn: int = BURN) -> float:
    """RMS of forecast minus sample past the burn-in, in each coordinate's rms; nan without blocks."""
    errors = []
    for k, starts, y_hat in forecast:
        truth = np.stack([ys[k][a : a + y_hat.shape[1]] for a in starts])
        errors.append((((y_hat - truth) / rms)[:, burn:] ** 2).ravel())
    if not errors:
        return float("nan")
    value = np.concatenate(errors)
    return float(np.sqrt(np.minimum(np.where(np.isfinite(value), value, 1e6), 1e6).mean()))


def seen(clips: list[Clip], effects: list[Effect], d: int, dt_s: float) -> list[Array]:
    """Noise-free coordinates (n, d) per clip as clock and camera give them; lost frames are counted."""
    out = [clip.x[:, :d].copy() for clip in clips]
    for effect in effects:
        if effect.camera is None or effect.camera[0] == "image":
            continue
        name, numbers = effect.camera
        count = 0
        for k, clip in enumerate(clips):
            rng = np.random.default_rng([numbers.get("seed", 0), k])
            n = len(out[k])
            t = np.arange(n) * dt_s
            if name == "view":
                q = out[k]
                out[k] = (
                    np.asarray(numbers["zoom"]) * q
                    + np.array(numbers["shift"])
                    + np.array(numbers["bend"]) * q**2
                )
            elif name == "drift":
                out[k] = out[k] + (clip.t0 + t)[:, None] * np.array(numbers["rate"])
            elif name == "jitter":
                spline = CubicSpline(t, out[k])
                out[k] = spline(np.clip(t + numbers["std"] * rng.standard_normal(n), 0.0, t[-1]))
            elif name == "blur":
                total = CubicSpline(t, out[k]).antiderivative()
                early = np.maximum(t - numbers["exposure"], 0.0)
                span = np.maximum(t - early, 1e-9)[:, None]
                out[k] = np.where(t[:, None] > 0, (total(t) - total(early)) / span, out[k])
            else:
                index = np.arange(n)
                at = 1
                while at < n:
                    if rng.random() < numbers["share"] / (0.5 * numbers["longest"] + 1.0):
                        length = int(rng.integers(1, numbers["longest"] + 1))
                        count += len(index[at : at + length])
                        index[at : at + length] = index[at - 1]
                        at += length
                    at += 1
                out[k] = out[k][index]
        if name == "drops":
            effect.parameters = {"count": count}
    return out


def unseen(y: Array, t: Array, effects: list[Effect]) -> Array:
    """Coordinates (..., d) behind what a changed or drifting camera shows at times ``t`` (...)."""
    for effect in reversed(effects):
        if effect.camera and effect.camera[0] == "view":
            n = effect.camera[1]
            x = y - np.array(n["shift"])
            a, z = np.array(n["bend"]), np.asarray(n["zoom"])
            y = 2.0 * x / (z + np.sign(z) * np.sqrt(np.maximum(z * z + 4.0 * a * x, 1e-12)))
        elif effect.camera and effect.camera[0] == "drift":
            y = y - t[..., None] * np.array(effect.camera[1]["rate"])
    return y


def reseen(q: Array, t: Array, effects: list[Effect]) -> Array:
    """The inverse of :func:`unseen`."""
    for effect in effects:
        if effect.camera and effect.camera[0] == "view":
            n = effect.camera[1]
            q = np.asarray(n["zoom"]) * q + np.array(n["shift"]) + np.array(n["bend"]) * q**2
        elif effect.camera and effect.camera[0] == "drift":
            q = q + t[..., None] * np.array(effect.camera[1]["rate"])
    return q
