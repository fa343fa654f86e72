"""When a recording can show an effect: one rule a family, from what its signature needs.

A grade is ``yes``, ``weak`` or ``no``, the reason, and what to record instead, with its length.
"""

from lagsplat.diagnose.data_quality.excitation_measures import ExcitationMeasures, InputMeasures

Grade = tuple[str, str, str]


def _grade(yes: bool, weak: bool, reason: str, record: str) -> Grade:
    return ("yes" if yes else "weak" if weak else "no", reason, record)


def _swings(m: ExcitationMeasures) -> str:
    return f"{m.periods:.3g} periods, large swings {m.amplitude_ratio:.2g} times the small ones"


def _let_go(m: ExcitationMeasures, periods: float = 10.0) -> str:
    return f"let it go from a large deflection and record {periods * m.period_s:.3g} s, until it is at rest"


def viscous_damping(m: ExcitationMeasures) -> Grade:
    """Decay that is the same at every amplitude."""
    return _grade(m.amplitude_ratio > 1.8 and m.periods > 4, m.periods > 3, _swings(m), _let_go(m))


def linear_stiffness(m: ExcitationMeasures) -> Grade:
    """A frequency, and a static answer that tells it from inertia."""
    static = m.driven and any(channel.low < 0.5 for channel in m.inputs)
    reason = "slow inputs show stiffness apart from inertia" if static else "only the ratio to inertia shows"
    return _grade(static and m.periods > 3, m.periods > 2, reason, _hold(m))


def mass_change(m: ExcitationMeasures) -> Grade:
    """Frequency and damping change together, the static answer does not."""
    broad = m.driven and any(channel.low < 0.5 and channel.high > 0.8 for channel in m.inputs)
    reason = "inputs below and at the natural frequency" if broad else "only the ratio to stiffness shows"
    return _grade(broad and m.periods > 3, m.periods > 2, reason, _hold(m))


def _hold(m: ExcitationMeasures) -> str:
    return f"drive it by steps held for {3 * m.period_s:.3g} s each, with the input recorded"


def constant_force(m: ExcitationMeasures) -> Grade:
    """A shifted rest."""
    reason = f"{m.periods:.3g} periods about one middle" + (
        f", and at rest for {m.rest_periods:.2g}" if m.rest_periods else ""
    )
    return _grade(m.rest_periods > 0.5 or m.periods > 5, m.periods > 2, reason, _let_go(m))


def cubic_stiffness(m: ExcitationMeasures) -> Grade:
    """A frequency that depends on amplitude."""
    wide = m.amplitude_ratio > 2.0
    return _grade(
        wide and m.periods > 5,
        m.amplitude_ratio > 1.3 or m.driven,
        _swings(m),
        f"record swings at two amplitudes, one twice the other, {8 * m.period_s:.3g} s each",
    )


def coulomb_friction(m: ExcitationMeasures) -> Grade:
    """A step of force at every reversal; small swings show it best."""
    reason = f"{m.reversals} reversals, {_swings(m)}"
    yes = m.reversals >= 6 and (m.amplitude_ratio > 2.0 or m.rest_periods > 0.5)
    return _grade(yes, m.reversals >= 4, reason, _let_go(m))


def stribeck_friction(m: ExcitationMeasures) -> Grade:
    """Friction that falls as sliding begins."""
    reason = f"{100 * m.slow_share:.2g} % of the samples creep, {m.reversals} reversals"
    return _grade(
        m.slow_share > 0.1 and m.reversals >= 6,
        m.slow_share > 0.05 and m.reversals >= 4,
        reason,
        f"record slow reversals for {20 * m.period_s:.3g} s, a tenth of the time nearly at rest",
    )


def load_dependent_friction(m: ExcitationMeasures) -> Grade:
    """Friction that grows with the load: two loads are needed."""
    loads = m.holds >= 2 or any(channel.levels >= 3 for channel in m.inputs)
    return _grade(
        loads and m.reversals >= 8 and m.amplitude_ratio > 2.0,
        m.amplitude_ratio > 2.0 and m.reversals >= 6,
        f"{m.reversals} reversals, {'several' if loads else 'one'} static load(s)",
        f"record {10 * m.period_s:.3g} s of small swings about each of two loaded poses",
    )


def quadratic_drag(m: ExcitationMeasures) -> Grade:
    """Decay that is faster at large swings."""
    reason = _swings(m)
    return _grade(m.amplitude_ratio > 3.0 and m.periods > 4, m.amplitude_ratio > 1.8, reason, _let_go(m))


def hysteresis(m: ExcitationMeasures) -> Grade:
    """A loop that does not depend on speed."""
    slow = m.driven and any(channel.low < 0.4 for channel in m.inputs)
    reason = f"{m.reversals} reversals, {_swings(m)}{', slow inputs among them' if slow else ''}"
    return _grade(
        m.reversals >= 8 and m.amplitude_ratio > 2.0,
        m.reversals >= 6,
        reason,
        f"record slow cycles at three amplitudes and two speeds, {20 * m.period_s:.3g} s",
    )


def creep(m: ExcitationMeasures) -> Grade:
    """A slow answer to a step, and stiffness that grows with speed."""
    wide = m.speed_ratio > 2.0 or any(c.moves and c.steps and c.low < 0.3 for c in m.inputs) or m.holds >= 2
    return _grade(
        wide and m.periods > 5,
        m.periods > 8,
        f"slow half-swings last {m.speed_ratio:.2g} times the fast ones, {m.holds} hold(s)",
        f"hold a step for {5 * m.period_s:.3g} s or more, release it, and swing for as long",
    )


def joint_backlash(m: ExcitationMeasures) -> Grade:
    """Free play about the rest: the smallest swings show it."""
    return _grade(
        m.amplitude_ratio > 3.0 and m.reversals >= 8,
        m.amplitude_ratio > 1.8 or m.slow_share > 0.1,
        _swings(m),
        _let_go(m, 15.0),
    )


def end_stop(m: ExcitationMeasures) -> Grade:
    """A force on one side only, met at several speeds."""
    return _grade(
        m.reversals >= 6 and m.amplitude_ratio > 1.5,
        m.reversals >= 4,
        f"{m.reversals} reversals, {_swings(m)}",
        f"reach the suspected stop at three speeds within {10 * m.period_s:.3g} s",
    )


def external_push(m: ExcitationMeasures) -> Grade:
    """An event: it shows whenever the rest of the motion is known."""
    reason = f"{m.periods:.3g} periods of motion"
    return _grade(m.periods > 6, m.periods > 3, reason, f"record {10 * m.period_s:.3g} s or more")


def external_periodic_force(m: ExcitationMeasures) -> Grade:
    """A line that no input explains; at rest it stands alone."""
    return _grade(
        m.rest_periods > 5 or m.periods > 15,
        m.periods > 6,
        f"{m.periods:.3g} periods, the longest rest {m.rest_periods:.2g}",
        f"record {15 * m.period_s:.3g} s, ten periods of it left at rest",
    )


def parameter_drift(m: ExcitationMeasures) -> Grade:
    """A slow change over the whole recording."""
    return _grade(
        m.periods > 25,
        m.periods > 8,
        f"{m.periods:.3g} periods in {m.clips} clip(s)",
        f"repeat the same motion early and late within {40 * m.period_s:.3g} s",
    )


def hidden_mode(m: ExcitationMeasures) -> Grade:
    """A second resonance, and what it gives back."""
    broad = any(channel.high > 1.5 for channel in m.inputs)
    sharp = m.samples_per_period > 25 and m.swing_over_noise > 30
    return _grade(
        (broad or sharp) and m.periods > 6,
        m.periods > 4,
        "inputs reach above the natural frequency" if broad else _swings(m),
        f"drive it up to twice the natural frequency, then let it ring for {10 * m.period_s:.3g} s",
    )


def _timing(m: ExcitationMeasures, record: str) -> Grade:
    reason = f"between two samples it moves {m.step_over_noise:.2g} times the noise"
    return _grade(m.step_over_noise > 4, m.step_over_noise > 1, reason, record)


def time_jitter(m: ExcitationMeasures) -> Grade:
    """Errors that grow with speed."""
    return _timing(m, "record faster swings, with the sensor's noise reduced")


def frame_drops(m: ExcitationMeasures) -> Grade:
    """Jumps along the motion."""
    return _timing(m, "record faster swings, or read the camera's own frame counter")


def camera_change(m: ExcitationMeasures) -> Grade:
    """Coordinates that are scaled and shifted although the mechanism is the same."""
    nonlinear = m.amplitude_ratio > 2.0
    return _grade(
        False,
        m.periods > 3 and (nonlinear or m.driven),
        "without pictures only the curvature of the law tells a scale",
        "film a static background too, and give the video",
    )


def camera_drift(m: ExcitationMeasures) -> Grade:
    """A slow shift of everything that is seen."""
    reason = f"{m.periods:.3g} periods; a drift of the rest looks the same"
    return _grade(False, m.periods > 8, reason, "film a static background too, and give the video")


def exposure_blur(m: ExcitationMeasures) -> Grade:
    """Fast motion that is seen smaller and later."""
    fast = m.samples_per_period < 25 or m.speed_ratio > 2.0
    reason = f"{m.samples_per_period:.3g} samples a period"
    return _grade(False, fast, reason, "give the video, with its exposure time")


def input_gain(c: InputMeasures, m: ExcitationMeasures) -> Grade:
    """The answer in proportion to the input."""
    reason = f"{c.name} moves, between {c.low:.2g} and {c.high:.2g} natural frequencies"
    return _grade(m.periods > 4, True, reason, f"record {10 * m.period_s:.3g} s of it")


def input_lag(c: InputMeasures, m: ExcitationMeasures) -> Grade:
    """An answer that fades and falls behind as the input gets faster."""
    reason = f"{c.name} has {c.steps} step(s) and reaches {c.high:.2g} natural frequencies"
    yes = c.steps >= 3 or c.high > 1.2
    return _grade(yes, c.high > 0.4, reason, f"drive it by steps, or up to twice the natural frequency "
                  f"({1 / m.period_s:.3g} Hz)")  # fmt: skip


def input_delay(c: InputMeasures, m: ExcitationMeasures) -> Grade:
    """An answer that is late and whole."""
    return input_lag(c, m)


def time_offset(c: InputMeasures, m: ExcitationMeasures) -> Grade:
    """Two clocks that differ; a delay of the input looks the same without an event that both show."""
    grade = input_lag(c, m)
    weak = "weak" if grade[0] == "yes" else grade[0]
    return (
        weak,
        grade[1] + "; a delay looks the same",
        "record an event that both show, such as a knock",
    )


def input_dead_zone(c: InputMeasures, m: ExcitationMeasures) -> Grade:
    """No answer to small inputs."""
    reason = (
        f"{c.name} {'crosses zero' if c.crosses_zero else 'stays on one side of zero'}, "
        f"{100 * c.small_share:.2g} % of it small"
    )
    return _grade(c.crosses_zero and c.small_share > 0.1, c.small_share > 0.03, reason,
                  f"let it pass slowly through zero for {10 * m.period_s:.3g} s")  # fmt: skip


def input_saturation(c: InputMeasures, m: ExcitationMeasures) -> Grade:
    """No more answer to large inputs."""
    reason = f"{c.name} peaks at {c.levels} size(s)"
    return _grade(c.levels >= 3, c.levels >= 2, reason,
                  f"drive it at three sizes up to its limit, {5 * m.period_s:.3g} s each")  # fmt: skip


def input_backlash(c: InputMeasures, m: ExcitationMeasures) -> Grade:
    """Play that is taken up at every reversal of the input."""
    reason = f"{c.name} reverses {c.reversals} times, from {c.levels} size(s)"
    return _grade(c.reversals >= 8 and c.levels >= 2, c.reversals >= 4, reason,
                  f"drive it by slow triangles of two sizes for {20 * m.period_s:.3g} s")  # fmt: skip


RULES = {
    rule.__name__: rule
    for rule in (
        viscous_damping, linear_stiffness, mass_change, constant_force, cubic_stiffness, coulomb_friction,
        stribeck_friction, load_dependent_friction, quadratic_drag, hysteresis, creep, joint_backlash,
        end_stop, external_push, external_periodic_force, parameter_drift, hidden_mode, time_jitter,
        frame_drops, camera_change, camera_drift, exposure_blur,
    )
}  # fmt: skip
INPUT_RULES = {
    rule.__name__: rule
    for rule in (
        input_gain, input_lag, input_delay, input_dead_zone, input_saturation, input_backlash, time_offset,
    )
}  # fmt: skip
