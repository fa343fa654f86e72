"""What a LeRobot dataset or an HDF5 file holds, in words, and the commands that follow from it."""

import shlex
from collections.abc import Sequence

from lagsplat.io.lerobot.dataset import Feature
from lagsplat.io.lerobot.survey import CameraSummary, LerobotSurvey
from lagsplat.io.lerobot.units import ACTION, STATE, describe_unit
from lagsplat.io.trajectory.hdf5 import Hdf5Survey
from lagsplat.io.video.proposal import fit_frame
from lagsplat.report.inspection.words import quote, write_columns

MAX_LISTED = 12


def describe_lerobot(survey: LerobotSurvey) -> str:
    """Describe version, episodes, features and cameras, what is damaged, and the commands that use it."""
    dataset, lengths = survey.dataset, survey.lengths
    robot = dataset.robot or "a robot without a type"
    lines = [
        f"source     {dataset.path.name} (LeRobot {dataset.version}, {robot})",
        f"episodes   {len(lengths)} of {min(lengths)} to {max(lengths)} frames, {sum(lengths)} together",
        f"duration   {survey.duration_s:.3f} s, {dataset.rate_hz:g} frames/s",
        *(_describe_feature(feature) for feature in dataset.numeric),
        *(_describe_camera(camera) for camera in survey.cameras),
        *(f"pictures   {name}, inside the tables: not read" for name in _list_images(survey)),
        *([] if survey.cameras else ["camera     none with films"]),
        f"unit       {_describe_unit(survey)}",
        *(f"damaged    {problem}" for problem in survey.problems),
    ]
    return "\n".join([*lines, *_list_commands(survey)])


def suggest_lerobot_overrides(survey: LerobotSurvey) -> list[str]:
    """Suggest the overrides that make a recording of the dataset's first camera; none without a camera."""
    if not survey.cameras:
        return []
    camera, dataset = survey.cameras[0], survey.dataset
    height, width = fit_frame(camera.height, camera.width) if camera.height else (0, 0)
    return [
        "recording=filmed",
        f"recording.path={quote(str(dataset.path))}",
        "recording.kind=lerobot",
        f"recording.lerobot.camera={quote(camera.name)}",
        f"recording.lerobot.inputs=[{ACTION if ACTION in dataset.features else ''}]",
        *([] if survey.unit.name else ["recording.lerobot.joint_unit=degree"]),
        *([f"recording.height={height}", f"recording.width={width}"] if height else []),
    ]


def _describe_feature(feature: Feature) -> str:
    named = [part for part in feature.parts if part]
    shown = f": {_shorten(named)}" if named else ""
    return f"feature    {feature.name}, {feature.dtype} {list(feature.shape)}{shown}"


def _describe_camera(camera: CameraSummary) -> str:
    size = f"{camera.width} x {camera.height} px" if camera.height else "of unknown size"
    return f"camera     {camera.name}, {size}, {camera.films} film(s), {camera.duration_s:.3f} s"


def _list_images(survey: LerobotSurvey) -> list[str]:
    return [name for name, feature in survey.dataset.features.items() if feature.dtype == "image"]


def _describe_unit(survey: LerobotSurvey) -> str:
    columns = [name for feature in survey.dataset.numeric for name in feature.columns]
    if survey.unit.name:
        return describe_unit(survey.unit, [name for name in columns if name.startswith((STATE, ACTION))])
    return f"to be given by joint_unit: {survey.unit.reason}"


def _list_commands(survey: LerobotSurvey) -> list[str]:
    lines = []
    if STATE in survey.dataset.features:
        unit = "" if survey.unit.name else " diagnose.joint_unit=degree"
        path = shlex.quote(str(survey.dataset.path))
        lines = [
            f"as a log   lagsplat diagnose sim=SIM real={path}{unit}",
            "           its states are the coordinates, its actions the inputs; choose with diagnose.columns",
        ]
    overrides = suggest_lerobot_overrides(survey)
    if not overrides:
        return lines
    return [
        *lines,
        "as a film  lagsplat fit out=FOLDER system=SYSTEM \\",
        *(f"           {shlex.quote(override)} \\" for override in overrides[:-1]),
        f"           {shlex.quote(overrides[-1])}",
        "           leave out inputs that do not drive the mechanism; crop around it",
    ]


def describe_hdf5(survey: Hdf5Survey) -> str:
    """Describe groups and datasets of an HDF5 file, what is not read, and the command that uses it."""
    lines = [f"source     {survey.path.name} (HDF5)"]
    if survey.demos:
        counts = [rows for _, rows in survey.demos]
        lines.append(
            f"demos      {len(counts)} of {min(counts)} to {max(counts)} samples, as robomimic writes them"
        )
    lines += [f"group      {name}" for name in survey.groups[:MAX_LISTED]]
    lines += [f"dataset    {each}" for each in survey.datasets[:MAX_LISTED]]
    more = len(survey.groups[MAX_LISTED:]) + len(survey.datasets[MAX_LISTED:])
    lines += [f"           and {more} more"] if more else []
    lines += [f"not read   {each}" for each in survey.refused[:MAX_LISTED]]
    mapping = f" {shlex.quote(write_columns(survey.proposal))}" if survey.proposal else ""
    return "\n".join(
        [
            *lines,
            f"columns    {_shorten(survey.columns)}",
            f"to use it  lagsplat diagnose sim=SIM real={shlex.quote(str(survey.path))}{mapping}",
        ]
    )


def _shorten(names: Sequence[str]) -> str:
    return ", ".join(names[:MAX_LISTED]) + (", ..." if len(names) > MAX_LISTED else "")
