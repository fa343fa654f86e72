"""Export a diagnosis of a MuJoCo model for MuJoCo's identification toolbox, `mujoco.sysid`."""

import logging
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from lagsplat.io.files.artifact import read_header
from lagsplat.io.files.atomic import copy_file
from lagsplat.io.files.sysid_yaml import write_sysid_parameters
from lagsplat.io.mujoco.model import MujocoSelection, load_mujoco, load_spec
from lagsplat.io.mujoco.sysid_parameters import list_sysid_parameters
from lagsplat.io.sources import find_sources, prefer_numbers, read_sources
from lagsplat.io.trajectory.sysid_series import (
    CONTROL,
    CONTROL_END,
    MEASURED_END,
    POSITION,
    SUFFIXES,
    VELOCITY,
    Signal,
    write_series,
)
from lagsplat.io.trajectory.trajectory import Trajectory
from lagsplat.pipelines.apply_diagnosis import AUGMENTED_FILE

PATCH = "patched.xml"
START, FITTED = "params_x_0.yaml", "params_x_hat.yaml"  # as the toolbox calls them in its own results
log = logging.getLogger(__name__)


def export_sysid(folder: Path, out: Path) -> tuple[Path, ...]:
    """Write the recordings and the changed parameters of the diagnosis in ``folder``, for `mujoco.sysid`.

    Of each clip of a recording ``NAME_measured.npz`` and ``NAME_control.npz``, which the toolbox loads by
    `TimeSeries.load_from_disk`; where the diagnosis has a ``patched.xml``, that model, ``params_x_0.yaml``
    with the sim's values and ``params_x_hat.yaml`` with the patched ones, loaded by
    `ParameterDict.load_from_disk`. What of the patch is no parameter is logged.

    Returns:
        The files that were written.

    Raises:
        FileNotFoundError: no diagnosis is in ``folder``, or its sim or recordings were moved.
        ValueError: its sim is no MuJoCo model or URDF, or its recordings are films.
    """
    path = folder / AUGMENTED_FILE
    if not path.is_file():
        raise FileNotFoundError(f"{path}: not there; name the folder of a diagnosis")
    header = read_header(path)
    if "sim" not in header or "real" not in header:
        raise ValueError(f"{path}: not what a diagnosis writes; name the folder of a diagnosis")
    config: dict[str, Any] = header["config"]
    sources = find_sources(header["sim"])
    if sources[0].kind != "mujoco":
        what = f"its sim {header['sim']} is a {sources[0].kind}"
        raise ValueError(f"{folder}: {what}; mujoco.sysid identifies MuJoCo models")
    sim = Path(sources[0].path)
    choice = {name: config.get(name) for name in ("joints", "actuators", "parameters")}
    chosen = load_mujoco(sim, **choice)
    recordings = prefer_numbers(find_sources(header["real"]), config["columns"])
    written: list[Path] = []
    for motion in read_sources(recordings, columns=config["columns"]):
        written += _write_motion(motion, chosen, out)
    patched = folder / PATCH
    if not patched.is_file():
        log.warning("%s: there is no %s, so the parameters are those of the sim, unchanged", folder, PATCH)
        return tuple(written)
    before = load_spec(sim, choice["parameters"])
    parameters, others = list_sysid_parameters(before, load_spec(patched))
    for other in others:
        log.warning("no parameter: %s; it is in the model alone", other)
    write_sysid_parameters(out / START, [replace(each, value=each.nominal) for each in parameters])
    write_sysid_parameters(out / FITTED, parameters)
    model = out / f"{sim.stem}.xml"
    copy_file(patched, model)
    return (*written, out / START, out / FITTED, model)


def _write_motion(motion: Trajectory, chosen: MujocoSelection, out: Path) -> Sequence[Path]:
    """Measurements and controls of every clip, under the names of the model's joints and actuators."""
    if (motion.d, motion.n_u) != (len(chosen.joints), len(chosen.actuators)):
        counts = f"{motion.d} coordinate(s) and {motion.n_u} input(s)"
        names = f"joints {list(chosen.joints)} and actuators {list(chosen.actuators)}"
        raise ValueError(f"{motion.source}: {counts}, but the model has {names}; name the same as diagnosed")
    files = []
    clips = motion.clips()
    for number, clip in enumerate(clips):
        stem = Path(motion.source).stem + (f"_{number}" if len(clips) > 1 else "")
        measured = [
            Signal(name + SUFFIXES[kind], kind, column)
            for kind, block in ((POSITION, clip.q), (VELOCITY, clip.v))
            if block is not None
            for name, column in zip(chosen.joints, block.T, strict=True)
        ]
        control = [
            Signal(name + SUFFIXES[CONTROL], CONTROL, column)
            for name, column in zip(chosen.actuators, clip.u.T, strict=True)
        ]
        for end, signals in ((MEASURED_END, measured), (CONTROL_END, control)):
            if signals:
                files.append(out / f"{stem}{end}.npz")
                write_series(files[-1], clip.time_s, signals)
    return files
