"""Add the effects of a diagnosis to a simulator; project given simulators on polynomial fields."""

import os
from collections.abc import Sequence
from pathlib import Path

from lagsplat.diagnose.augmented.model import (
    AugmentedSimulator,
    load_augmented,
    save_augmented,
    transfer_effects,
)
from lagsplat.diagnose.estimation.dataset import OperatingRegion
from lagsplat.diagnose.simulators.mujoco_model import project_mujoco
from lagsplat.diagnose.simulators.projection import ProjectedModel
from lagsplat.diagnose.simulators.python_model import load_python, project_python
from lagsplat.io.files.artifact import read_header
from lagsplat.io.files.atomic import load_json
from lagsplat.io.mujoco.model import load_mujoco
from lagsplat.io.sources import find_sources

AUGMENTED_FILE = "augmented.safetensors"
MODELS = ("run", "model", "mujoco", "python")  # kinds of sources that are simulators, not recordings


def apply_diagnosis(
    diagnosis: str | os.PathLike[str],
    sim: str | None = None,
    *,
    out: str | os.PathLike[str],
    joints: Sequence[str] | None = None,
    actuators: Sequence[str] | None = None,
    parameters: str | None = None,
) -> AugmentedSimulator:
    """Add the effects of a diagnosis to a simulator, and write the result.

    The fitted effects are read from the augmented simulator beside the diagnosis.

    Args:
        diagnosis: The ``diagnosis.json``, or its folder.
        sim: A MuJoCo ``.xml``, a ``.urdf``, ``file.py:attribute`` or a run, with its own parameters; the
            diagnosed simulator, with its parameters as refitted, if left out.
        out: The file that is written, ``.safetensors``.
        joints: Joints of a MuJoCo model that are the coordinates; all if left out.
        actuators: Actuators of a MuJoCo model that are the inputs; all if left out.
        parameters: A file of `mujoco.sysid` whose values replace the MuJoCo model's own.

    Raises:
        FileNotFoundError: no diagnosis, or no augmented simulator beside it.
        ValueError: the simulator is known by recordings only, or has other coordinates or inputs.

    Example:
        >>> import lagsplat
        >>> lagsplat.apply_diagnosis("diagnosis", out="augmented.safetensors").model.d
        1
    """
    file = Path(diagnosis).expanduser()
    file = file / "diagnosis.json" if file.is_dir() else file
    stored, path = load_json(file), file.parent / AUGMENTED_FILE
    if not path.is_file():
        raise FileNotFoundError(
            f"{path}: not there (verdict {stored.get('verdict')!r}); keep the folder of a diagnosis "
            "together, or diagnose again"
        )
    augmented, header = load_augmented(path), read_header(path)
    if sim is not None:
        if not {source.kind for source in find_sources(sim)} <= set(MODELS):
            raise ValueError(
                f"sim={sim}: a sim known by its recordings was identified by the diagnosis and is in "
                f"{path}; leave sim= out to get it with its effects"
            )
        projected = sample_simulator(
            sim, augmented.region, joints=joints, actuators=actuators, parameters=parameters
        )
        augmented = transfer_effects(augmented, projected.model)
        header = {**header, "sim": sim, "sim_error": projected.error}
    header.pop("stamp", None)
    save_augmented(out, augmented, {**header, "diagnosis": str(file)})
    return augmented


def sample_simulator(
    name: str,
    region: OperatingRegion,
    *,
    joints: Sequence[str] | None = None,
    actuators: Sequence[str] | None = None,
    parameters: str | None = None,
) -> ProjectedModel:
    """Project the simulator that ``sim=name`` gives on polynomial fields over a region of states and inputs.

    Of an augmented simulator the model without its effects is taken. The result has the error of the
    acceleration. ``joints``, ``actuators`` and ``parameters`` are as of
    `apply_diagnosis`.

    Raises:
        FileNotFoundError: nothing is there.
        ValueError: it is a recording, or does not fit the region's coordinates and inputs.
    """
    source, *more = find_sources(name)
    if more:
        raise ValueError(f"sim={name}: {1 + len(more)} things; name one model")
    if source.kind == "mujoco":
        path = Path(source.path)
        chosen = load_mujoco(path, joints=joints, actuators=actuators, parameters=parameters)
        return project_mujoco(path, chosen, region)
    if source.kind == "python":
        return project_python(load_python(source.path), region, what=source.path)
    if source.kind == "run":
        from lagsplat.diagnose.simulators.fitted_run import project_run
        from lagsplat.stage2.fit import load_dynamics

        lagrangian, _ = load_dynamics(Path(source.path) / "dynamics.safetensors")
        return project_run(lagrangian, region, what=source.path)
    if source.kind == "model":
        return ProjectedModel(load_augmented(source.path).model, 0.0)
    raise ValueError(f"{source.path}: a recording, which is identified and not sampled")
