"""The withheld effects: what each does at a magnitude from 0 to 1, and its truth in the report's units."""

import numpy as np

from benchmarks.gapgen import laws
from benchmarks.gapgen.effect import (
    ACTUATION,
    CAMERA,
    CONTACT,
    DISSIPATION,
    EXTRA,
    IN_CLASS,
    MACHINE,
    MEMORY,
    OUTSIDE,
    OUTSIDE_FORCED,
    OUTSIDE_WIDE,
    Effect,
    Maker,
    Setting,
)
from benchmarks.gapgen.machine_effects import machine, whole_mass
from benchmarks.gapgen.outside import outside


def in_class(name: str, s: Setting, i: int, j: int, rng: np.random.Generator) -> Maker:
    """Changes of parameters that the nominal equations have already."""
    w2 = (2.0 * np.pi * s.f1_hz[i]) ** 2
    sign = -1.0 if rng.random() < 0.4 else 1.0
    pick, power, angle = rng.random(), rng.uniform(0.96, 1.04), rng.uniform(0.5, 1.5)

    def make(a: float) -> Effect:
        if name == "viscous_damping":
            up = 2.0 * s.zeta[i] * 2.0 * np.pi * s.f1_hz[i]
            rate = (
                a * 3.0 * 2.0 * np.pi * s.f1_hz[i] * 0.3
                if sign > 0 or pick < 0.5
                else -0.85 * min(a * 4, 1) * up
            )
            return Effect(name, [(laws.VISCOUS, i, j, [rate, power, s.v[i]])], parameters={"rate": rate})
        if name == "linear_stiffness":
            ratio = 1.0 + a if sign > 0 else 1.0 / (1.0 + a)
            if pick < 0.5 or s.system == "soft_robot" or s.system.startswith("mujoco_"):
                return Effect(name, [(laws.SPRING, i, j, [(ratio - 1.0) * w2])], parameters={"ratio": ratio})
            return Effect(name, [(laws.SCALED_POTENTIAL, i, j, [ratio])], parameters={"ratio": ratio})
        if name == "mass_change":
            ratio = 1.0 + 1.5 * a if sign > 0 else 1.0 - 0.5 * a
            if s.wide:
                return whole_mass(ratio, i, j)
            return Effect(name, [(laws.INERTIA, i, j, [ratio - 1.0])], parameters={"ratio": ratio})
        if name == "constant_force":
            size = sign * a * 1.5 * w2 * s.x[i]
            if s.system in ("pendulum", "rocker", "mujoco_pendulum") and pick < 0.7:
                lean = -size / w2 * (1.0 if abs(size / w2) < 1.0 else 1.0 / abs(size / w2))
                row = (laws.TILT, i, j, [w2, lean])
                return Effect(name, [row], parameters={"acceleration": float(-w2 * np.sin(lean))})
            return Effect(name, [(laws.CONSTANT, i, j, [size])], parameters={"acceleration": size})
        if name == "input_gain":
            ratio = 1.0 + 1.5 * a if sign > 0 else 1.0 - a
            return Effect(name, operators=[(j, "gain", {"ratio": ratio})], parameters={"ratio": ratio})
        k3 = (1.0 if sign > 0 else -0.5) * a * 2.0 * w2 / s.top[i] ** 2
        row = (laws.HARDENING, i, j, [k3, s.top[i] * angle])
        return Effect(name, [row], parameters={"coefficient": k3})

    return make


def dissipative(name: str, s: Setting, i: int, j: int, rng: np.random.Generator) -> Maker:
    """Friction and drag."""
    w = 2.0 * np.pi * s.f1_hz[i]
    force = w**2 * s.x[i]
    set_valued = rng.random() < 0.5
    excess, v_s = rng.uniform(0.5, 1.6), s.v[i] * np.exp(rng.normal(np.log(0.15), 0.4))
    chi, power = rng.uniform(0.5, 1.8), rng.choice([1.8, 1.9, 2.1, 2.2])
    # the bristle must stay resolved by the step at the highest speed
    slip = max(0.006 * s.x[i], 0.35e-3 / s.f1_hz[i] * s.v_top[i])
    damping = np.exp(rng.uniform(np.log(0.02), np.log(1.5)))  # over sqrt(stiffness)

    def make(a: float) -> Effect:
        if name == "quadratic_drag":
            c = a * 3.0 * w / s.v[i]
            row = (laws.DRAG, i, j, [c, power, s.v[i]])
            return Effect(name, [row], parameters={"coefficient": c, "exponent": float(power)})
        level = a * 0.6 * force
        top = level * (1.0 + excess) if name == "stribeck_friction" else level
        load = chi if name == "load_dependent_friction" else 0.0
        bristle = level / slip
        numbers = [level, top, v_s, load, force, 0.0, slip, damping * np.sqrt(bristle)]
        row = (laws.FRICTION if set_valued else laws.BRISTLE, i, j, numbers)
        parameters = {"acceleration": level}
        if name == "stribeck_friction":
            parameters = {"coulomb": level, "static": top, "velocity": float(v_s)}
        if name == "load_dependent_friction":
            parameters |= {"load_factor": chi, "load_reference": force}
        return Effect(name, [row], parameters=parameters)

    return make


def actuation(name: str, s: Setting, i: int, j: int, rng: np.random.Generator) -> Maker:
    """What stands between the logged input and the force."""
    period = 1.0 / s.f1_hz[0]
    phase, sharp = rng.uniform(0.0, 6.0), rng.uniform(4.0, 10.0)

    def make(a: float) -> Effect:
        if name == "input_lag":
            value = {"time_constant": a * 0.6 * period}
            return Effect(name, operators=[(j, "lag", value)], parameters=dict(value))
        if name == "input_delay":
            value = {"seconds": a * 0.35 * period, "phase": phase}
            return Effect(name, operators=[(j, "shift", value)], parameters={"delay": value["seconds"]})
        if name == "input_dead_zone":
            value = {"half_width": a * 0.9 * s.u_top[j]}
            return Effect(name, operators=[(j, "dead_zone", value)], parameters=dict(value))
        if name == "input_saturation":
            value = {"limit": float(s.u_top[j] * np.exp(1.2 * (0.35 - 2.6 * a))), "sharpness": sharp}
            return Effect(name, operators=[(j, "soft_limit", value)], parameters={"limit": value["limit"]})
        value = {"width": a * 1.4 * s.u_top[j]}
        return Effect(name, operators=[(j, "backlash", value)], parameters=dict(value))

    return make


def memorising(name: str, s: Setting, i: int, j: int, rng: np.random.Generator) -> Maker:
    """Hysteresis, creep and free play."""
    w2 = (2.0 * np.pi * s.f1_hz[i]) ** 2
    reach = s.x[i] * np.exp(rng.normal(np.log(0.3), 0.5))
    tau = np.exp(rng.uniform(np.log(0.7), np.log(8.0))) / np.sqrt(w2)
    spread, share, depth = rng.uniform(1.5, 2.2), rng.uniform(0.35, 0.65), rng.uniform(0.6, 1.0)

    def make(a: float) -> Effect:
        if name == "hysteresis":
            force = a * 1.0 * w2 * s.x[i]
            row = (laws.SLIP_CHAIN, i, j, [force, reach])
            return Effect(name, [row], parameters={"acceleration": force, "displacement": float(reach)})
        if name == "creep":
            row = (laws.CREEP, i, j, [a * 1.5 * w2, tau / spread, tau * spread, share])
            return Effect(name, [row], parameters={"stiffness_ratio": 1.5 * a, "time_constant": float(tau)})
        gap = a * 1.2 * s.top[i]
        row = (laws.FREE_PLAY, i, j, [w2, gap, 0.15 * gap + 1e-9, depth])
        return Effect(name, [row], parameters={"gap": gap, "removed_share": depth})

    return make


def contact(name: str, s: Setting, i: int, j: int, rng: np.random.Generator) -> Maker:
    """Stops, disturbances, drift and a mode that the mechanism was not known to have."""
    w = 2.0 * np.pi * s.f1_hz[i]
    side, pick = (1.0 if rng.random() < 0.5 else -1.0), rng.random()
    hard, loss = np.exp(rng.uniform(np.log(6.0), np.log(30.0))), rng.uniform(0.1, 0.6) / s.v[i]
    f = s.f1_hz[i] * (rng.uniform(0.25, 0.7) if pick < 0.4 else rng.uniform(1.4, 3.0))
    f_mode = s.f1_hz[i] * rng.uniform(1.25, 3.0)
    zeta, phase, bend = rng.uniform(0.015, 0.06), rng.uniform(0.0, 6.2), rng.uniform(0.0, 0.1)
    when = np.sort(rng.uniform(0.08, 0.92, 3)) * s.span_s
    long, sizes = (
        rng.uniform(0.15, 0.5, 3) / s.f1_hz[i],
        rng.choice([-1.0, 1.0], 3) * rng.uniform(0.6, 1.0, 3),
    )
    n_push = int(rng.integers(1, 4)) if s.span_s > 8.0 else 1

    def make(a: float) -> Effect:
        if name == "end_stop":
            place = side * s.top[i] * (1.0 - 0.9 * a**0.7)
            # effective stiffness at a depth of five hundredths of the reach
            row = (laws.STOP, i, j, [side, place, hard * w**2 / np.sqrt(0.05 * s.top[i]), loss])
            return Effect(name, [row], parameters={"position": place, "stiffness_ratio": float(hard)})
        if name == "external_periodic_force":
            size = a * 1.2 * w**2 * s.x[i]
            row = (laws.PERIODIC, i, j, [size, 2.0 * np.pi * f, phase, bend])
            truth = {"frequency_hz": float(f), "acceleration": size}
            return Effect(name, [row], parameters=truth, frequency_hz=[float(f)])
        if name == "parameter_drift":
            slow = s.span_s * 1.5
            if pick < 0.6:
                rate = side * min(a * 1.2, 0.8 if side < 0 else 9.0) / s.span_s
                row = (laws.DRIFT_POTENTIAL, i, j, [rate, slow])
                return Effect(name, [row], parameters={"rate": rate, "of": "stiffness"})
            rate = side * a * 2.0 * w**2 * s.x[i] / s.span_s
            row = (laws.DRIFT_FORCE, i, j, [rate, slow])
            return Effect(name, [row], parameters={"rate": rate, "of": "force"})
        if name == "hidden_mode":
            row = (laws.ABSORBER, i, j, [2.0 * np.pi * f_mode, 0.5 * a, zeta, 0.3 / s.top[i] ** 2 * bend])
            truth = {"frequency_hz": float(f_mode), "mass_ratio": 0.5 * a, "damping_ratio": float(zeta)}
            return Effect(name, [row], parameters=truth, frequency_hz=[float(f_mode)])
        numbers: list[float] = []
        for k in range(3):
            numbers += [
                float(when[k]),
                float(long[k]),
                float(sizes[k]) * a * 8.0 * w**2 * s.x[i] * (k < n_push),
            ]
        truth = {
            "times": when[:n_push].tolist(),
            "accelerations": [numbers[3 * k + 2] for k in range(n_push)],
        }
        spans = [[float(when[k]), float(when[k] + long[k])] for k in range(n_push)]
        return Effect(name, [(laws.PUSH, i, j, numbers)], parameters=truth, time_s=spans)

    return make


def watching(name: str, s: Setting, i: int, j: int, rng: np.random.Generator) -> Maker:
    """Errors of the clock and of the camera, as they show in a trajectory."""
    period = 1.0 / s.f1_hz[0]
    d = len(s.x)
    sign = -1.0 if rng.random() < 0.5 else 1.0
    phase, seed = rng.uniform(0.0, 6.0), int(rng.integers(2**31))
    way, tilt = rng.normal(size=d), rng.normal(size=d)
    zoomed = rng.random() < 0.5
    way2 = rng.normal(size=2)

    def make(a: float) -> Effect:
        if name == "time_offset":
            value = {"seconds": sign * a * 0.35 * period, "phase": phase}
            every = [(k, "shift", value) for k in range(len(s.u))]
            return Effect(name, operators=every, parameters={"offset": -value["seconds"]})
        if name == "time_jitter":
            numbers = {"std": a * 0.06 * period, "seed": seed}
            return Effect(name, camera=("jitter", numbers), parameters={"std": numbers["std"]})
        if name == "frame_drops":
            numbers = {"share": min(0.7 * a, 0.6), "longest": 1 + int(25.0 * a), "seed": seed}
            return Effect(name, camera=("drops", numbers))
        if s.film and name == "camera_change":
            numbers = {
                "shift_px": (5.0 * a * way2 / np.abs(way2).max()).tolist(),
                "rotation_deg": sign * 10.0 * a * abs(tilt[0]) / (1.0 + abs(tilt[0])),
                "zoom": 1.0 + 0.15 * a * sign,
            }
            return Effect(name, camera=("image", numbers), parameters=dict(numbers))
        if s.film and name == "camera_drift":
            numbers = {"px_per_s": (10.0 * a * way2 / np.abs(way2).max() / s.span_s).tolist()}
            return Effect(name, camera=("image", numbers), parameters=dict(numbers))
        if name == "camera_change":
            zoom = 1.0 + a * (0.8 if zoomed else 0.05) * sign
            shift = a * (0.2 if zoomed else 1.5) * s.x * way / np.abs(way).max()
            bend = 0.15 * a * tilt / s.top
            numbers = {"zoom": zoom, "shift": shift.tolist(), "bend": bend.tolist()}
            return Effect(name, camera=("view", numbers), parameters={"zoom": zoom, "shift": shift.tolist()})
        if name == "camera_drift":
            rate = a * 4.0 * s.x * way / np.abs(way).max() / s.span_s
            return Effect(name, camera=("drift", {"rate": rate.tolist()}), parameters={"rate": rate.tolist()})
        numbers = {"exposure": max(a * 0.6 * period, 1e-6)}
        return Effect(name, camera=("blur", numbers), parameters=dict(numbers))

    return make


def maker(name: str, s: Setting, i: int, j: int, rng: np.random.Generator) -> Maker:
    """The named effect on coordinate ``i`` or input ``j`` as a function of its magnitude.

    Raises:
        ValueError: if no such effect exists.
    """
    if s.wide and name in MACHINE:
        return machine(name, s, i, j, rng)
    groups = (
        (IN_CLASS, in_class),
        (DISSIPATION, dissipative),
        (ACTUATION, actuation),
        (MEMORY, memorising),
        ((*CONTACT, *EXTRA), contact),
        ((*OUTSIDE, *OUTSIDE_WIDE), outside),
        (CAMERA, watching),
    )
    for names, family in groups:
        if name in names:
            make = family(name, s, i, j, rng)
            break
    else:
        raise ValueError(f"effect {name!r}: none such")
    by_input = name in ACTUATION or name in ("input_gain", *OUTSIDE_FORCED)
    whole = name in CAMERA

    def placed(a: float) -> Effect:
        effect = make(a)
        effect.coordinate = None if by_input or whole else i
        effect.input = j if by_input else None
        return effect

    return placed
