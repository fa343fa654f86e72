"""Effects of machines: masses that are carried, rotors, controllers, motors, teeth, seals, shaken frames.

Their laws differ from those of the catalogue where physics offers another one: teeth with a second harmonic,
a stiffness wave with flanks, seals whose drag levels off, a motor whose supply sags by the power drawn, a
follower force with a limit, masses as parameters of the equations, a base that moves in space.
"""

import numpy as np

from benchmarks.gapgen import laws
from benchmarks.gapgen.effect import Effect, Maker, Setting


def whole_mass(ratio: float, i: int, j: int) -> Effect:
    """All masses of the mechanism times ``ratio``, their weight included."""
    return Effect("mass_change", [(laws.MASSES, i, j, [ratio])], parameters={"ratio": ratio})


def machine(name: str, s: Setting, i: int, j: int, rng: np.random.Generator) -> Maker:
    """The named effect on coordinate ``i`` or input ``j`` as a function of its magnitude.

    A payload sits on the first coordinate, and gains are those of the controller of input ``j``.

    Raises:
        ValueError: if no such effect exists.
    """
    families = {
        "payload": _masses,
        "armature": _masses,
        "controller_gain": _drives,
        "torque_speed_limit": _drives,
        "encoder_scale": _encoder,
        "cogging": _patterns,
        "parametric_stiffness": _patterns,
        "position_dependent_damping": _losses,
        "asymmetric_friction": _losses,
        "circulatory_force": _couplings,
        "base_motion": _couplings,
    }
    if name not in families:
        raise ValueError(f"effect {name!r}: none such; choose from {sorted(families)}")
    if name == "payload":
        i = 0
    if name == "controller_gain":
        i = int(np.argmax(np.abs(s.gain[:, j])))
    make = families[name](name, s, i, j, rng)

    def placed(a: float) -> Effect:
        effect = make(a)
        effect.coordinate = None if name == "base_motion" else i
        effect.input = j if name == "controller_gain" else None
        return effect

    return placed


def _masses(name: str, s: Setting, i: int, j: int, rng: np.random.Generator) -> Maker:
    def make(a: float) -> Effect:
        ratio = 1.5 * a
        if name == "armature":
            return Effect(name, [(laws.INERTIA, i, j, [ratio])], parameters={"ratio": ratio})
        kg = ratio * float(s.payload_kg[i])
        return Effect(name, [(laws.PAYLOAD, i, j, [kg])], parameters={"mass_ratio": ratio, "kg": kg})

    return make


def _drives(name: str, s: Setting, i: int, j: int, rng: np.random.Generator) -> Maker:
    w, pick = 2.0 * np.pi * s.f1_hz[i], rng.random()
    sign, share = (1.0 if rng.random() < 0.5 else -1.0), rng.uniform(0.0, 0.6)
    sag, tau, fast = rng.uniform(0.05, 0.3), rng.uniform(0.3, 2.0) / s.f1_hz[i], rng.uniform(0.7, 1.6)

    def make(a: float) -> Effect:
        if name == "controller_gain":
            kp = float(s.gain[i, j])
            ratio = 1.0 + a if sign > 0 else 1.0 / (1.0 + a)
            kd = (1.0 if pick < 0.7 else -0.3 * s.zeta[i]) * share * a * w
            truth = {"kp_ratio": ratio, "kd": kd}
            return Effect(name, [(laws.SERVO, i, j, [(ratio - 1.0) * kp, kd])], parameters=truth)
        top = float(np.abs(s.gain[i]) @ s.u_top)
        # at the least magnitude neither torque nor speed is ever short
        stall, no_load = top * 1.5 * (0.02 / a) ** 0.5, s.v_top[i] * fast * 3.0 * (0.02 / a) ** 0.5
        numbers = [stall, no_load, sag, tau]
        return Effect(
            name, [(laws.MOTOR, i, j, numbers)], parameters={"stall": stall, "no_load": float(no_load)}
        )

    return make


def _encoder(name: str, s: Setting, i: int, j: int, rng: np.random.Generator) -> Maker:
    sign, counts = (1.0 if rng.random() < 0.5 else -1.0), rng.random() < 0.6
    away, tilt = (1.0 if rng.random() < 0.5 else -1.0), rng.normal()

    def make(a: float) -> Effect:
        scale = 1.0 + sign * a * (0.8 if counts else 0.05)
        offset = float(away * a * (0.1 if counts else 1.5) * s.x[i])
        zoom, shift, bend = np.ones(len(s.x)), np.zeros(len(s.x)), np.zeros(len(s.x))
        # a magnet off its axis bends the scale
        zoom[i], shift[i], bend[i] = scale, offset, 0.05 * a * tilt / s.top[i]
        numbers = {"zoom": zoom.tolist(), "shift": shift.tolist(), "bend": bend.tolist()}
        return Effect(name, camera=("view", numbers), parameters={"scale": scale, "offset": offset})

    return make


def _patterns(name: str, s: Setting, i: int, j: int, rng: np.random.Generator) -> Maker:
    w2 = (2.0 * np.pi * s.f1_hz[i]) ** 2
    waves, phase, second = rng.uniform(2.0, 8.0), rng.uniform(0.0, 6.2), rng.uniform(0.0, 0.2)
    f, steep = s.f1_hz[i] * np.exp(rng.uniform(np.log(0.3), np.log(2.6))), rng.uniform(0.3, 2.0)

    def make(a: float) -> Effect:
        if name == "cogging":
            size = 0.8 * a * w2 * s.x[i]
            truth = {"acceleration": size, "pitch": float(2.0 * np.pi * s.x[i] / waves)}
            row = (laws.TEETH, i, j, [size, waves / s.x[i], phase, second])
            return Effect(name, [row], parameters=truth)
        row = (laws.MESH, i, j, [a, 2.0 * np.pi * f, phase, w2, steep])
        truth = {"depth": a, "frequency_hz": float(f)}
        return Effect(name, [row], parameters=truth, frequency_hz=[float(f)])

    return make


def _losses(name: str, s: Setting, i: int, j: int, rng: np.random.Generator) -> Maker:
    w = 2.0 * np.pi * s.f1_hz[i]
    centre, width = rng.uniform(-1.0, 1.0) * s.x[i], rng.uniform(0.4, 1.2) * s.x[i]
    pick, side, weak = rng.random(), rng.random() < 0.5, rng.uniform(0.0, 0.3)
    soft = float(s.v[i] * np.exp(rng.uniform(np.log(0.01), np.log(0.06))))

    def make(a: float) -> Effect:
        if name == "position_dependent_damping":
            rate = 3.0 * a * w
            truth = {"rate": rate, "place": float(centre), "width": float(width)}
            return Effect(name, [(laws.LOCAL_DAMPING, i, j, [rate, centre, width])], parameters=truth)
        if pick < 0.5:
            rate = 2.0 * a * w
            truth = {"forward": rate if side else 0.0, "backward": 0.0 if side else rate, "of": "speed"}
            return Effect(name, [(laws.ONE_WAY, i, j, [rate, 1.0 if side else -1.0])], parameters=truth)
        strong = 0.8 * a * w**2 * s.x[i]
        forward, backward = (strong, weak * strong) if side else (weak * strong, strong)
        truth = {"forward": forward, "backward": backward, "of": "direction"}
        row = (laws.LIP_SEAL, i, j, [forward, backward, soft])
        return Effect(name, [row], parameters=truth)

    return make


def _couplings(name: str, s: Setting, i: int, j: int, rng: np.random.Generator) -> Maker:
    sign, pick = (1.0 if rng.random() < 0.5 else -1.0), rng.random()
    other = int((i + 1 + rng.integers(max(len(s.x) - 1, 1))) % len(s.x))
    w = 2.0 * np.pi * s.f1_hz
    f = s.f1_hz[0] * np.exp(rng.uniform(np.log(0.4), np.log(2.5)))
    phase, bend = rng.uniform(0.0, 6.2), rng.uniform(0.0, 0.1)

    def make(a: float) -> Effect:
        if name == "base_motion":
            # as large as what pulls the first coordinate back
            size = a * w[0] ** 2 * s.x[0] * s.base_reach
            row = (laws.BASE, 0, j, [size, 2.0 * np.pi * f, phase, bend])
            truth = {"frequency_hz": float(f), "base_acceleration": size}
            return Effect(name, [row], parameters=truth, frequency_hz=[float(f)])
        by_speed = pick < 0.4
        coupling = sign * a * (np.sqrt(w[i] * w[other]) if by_speed else w[i] * w[other])
        lean = float(np.sqrt(s.inertia[other] / s.inertia[i]))
        rows = [
            (laws.COUPLING, i, j, [coupling * lean, other, float(by_speed), 2.0 * s.top[other]]),
            (laws.COUPLING, other, j, [-coupling / lean, i, float(by_speed), 2.0 * s.top[i]]),
        ]
        truth = {"coupling": float(coupling), "of": "speed" if by_speed else "position", "with": f"q{other}"}
        return Effect(name, rows, parameters=truth)

    return make
