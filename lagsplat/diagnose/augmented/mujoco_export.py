"""Effects of a diagnosis written into a MuJoCo model file, where MuJoCo has a counterpart of them."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from lagsplat.diagnose.augmented.model import AugmentedSimulator
from lagsplat.diagnose.augmented.mujoco_counterparts import COUNTERPARTS, Place
from lagsplat.diagnose.core.result import Candidate
from lagsplat.diagnose.effects.dynamics.linear_stiffness import SPRING
from lagsplat.diagnose.effects.dynamics.linear_stiffness import stiffness as stiffness_of
from lagsplat.diagnose.simulators.mujoco_model import load_mujoco, make_mujoco_fields, require_mujoco


def patch_xml(
    path: Path,
    out: Path,
    candidate: Candidate,
    joint: str | None,
    actuator: str | None,
    *,
    rest: Sequence[float] | None = None,
    joints: Sequence[str] | None = None,
    variant: str = "",
    stiffness: float = 0.0,
) -> tuple[str, ...]:
    """Write the model at ``path`` with the effect of ``candidate`` to ``out``; what was changed, for people.

    Nothing is written, and nothing returned, where MuJoCo has no such effect. ``rest`` (d,) is where the
    diagnosis has the joints' reference inertia, by default the model's own pose; ``joints`` are its
    coordinates. ``variant`` and ``stiffness`` are those of the effect's place in the catalogue.

    Raises:
        FileNotFoundError, ValueError: as `load_mujoco`, or the changed model is refused by MuJoCo.
    """
    values = {name: p.value for name, p in candidate.parameters.items()}
    entry = (candidate.name, values, joint, actuator, variant, stiffness)
    return _patch(path, out, [entry], rest=rest, joints=joints, actuators=None)


def patch_augmented(
    path: Path,
    out: Path,
    one: AugmentedSimulator,
    *,
    joints: Sequence[str] | None = None,
    actuators: Sequence[str] | None = None,
) -> tuple[str, ...]:
    """The same for all effects of an augmented sim; written only if each has a counterpart.

    Raises:
        FileNotFoundError, ValueError: as `patch_xml`.
    """
    chosen = load_mujoco(path, joints=joints, actuators=actuators)
    entries = []
    for n, effect in enumerate(one.effects):
        if effect.direction is not None and np.count_nonzero(effect.direction.covector) > 1:
            return ()  # between two joints
        along = None if effect.direction is None else int(np.argmax(np.abs(effect.direction.covector)))
        joint = None if along is None else chosen.joints[along]
        actuator = None if effect.channel is None else chosen.actuators[effect.channel]
        values = one.parameters(n)
        size = stiffness_of(effect.scales) if effect.variant == SPRING else effect.scales.stiffness
        entries.append((effect.effect.name, values, joint, actuator, effect.variant, size))
    return _patch(path, out, entries, rest=one.model.rest.tolist(), joints=joints, actuators=actuators)


def _patch(
    path: Path,
    out: Path,
    entries: Sequence[tuple[str, Mapping[str, Any], str | None, str | None, str, float]],
    *,
    rest: Sequence[float] | None,
    joints: Sequence[str] | None,
    actuators: Sequence[str] | None,
) -> tuple[str, ...]:
    mujoco = require_mujoco()
    chosen = load_mujoco(path, joints=joints, actuators=actuators)
    at = chosen.data.qpos[chosen.at_q].copy() if rest is None else np.asarray(rest, dtype=np.float64)
    mass = make_mujoco_fields(chosen).mass(at[None])[0]
    inverse = np.linalg.inv(mass)
    spec = mujoco.MjSpec.from_file(str(path))
    told: list[str] = []
    for name, values, joint, actuator, variant, stiffness in entries:
        alone = chosen.joints[0] if len(chosen.joints) == 1 else None
        driven = chosen.actuators[0] if len(chosen.actuators) == 1 else None
        joint, actuator = joint or alone, actuator or driven
        n = chosen.joints.index(joint) if joint in chosen.joints else 0
        place = Place(
            spec, chosen, _element(spec.joints, joint, path), _element(spec.actuators, actuator, path),
            float(mass[n, n]), float(inverse[n, n]), float(at[n]), variant, stiffness,
        )  # fmt: skip
        said = COUNTERPARTS[name](place, values) if name in COUNTERPARTS else ()
        if not said:
            return ()
        told += said
    if spec.meshes or spec.textures or spec.hfields or spec.skins:
        spec.meshdir = str((path.parent / (spec.meshdir or "")).resolve())
        spec.texturedir = str((path.parent / (spec.texturedir or "")).resolve())
    try:
        spec.compile()
    except ValueError as error:
        raise ValueError(f"{path}: MuJoCo refuses the changed model ({error}); {'; '.join(told)}") from error
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text(spec.to_xml(), encoding="utf-8")
    return tuple(told)


def _element(elements: Sequence[Any], name: str | None, path: Path) -> Any:
    if name is None:
        return None
    found = [element for element in elements if element.name == name]
    if not found:
        raise ValueError(f"{path}: {name!r} has no name in the file; give it one, so that it can be changed")
    return found[0]
