"""Which runs have Gaussians in space, and the files of a rig. Loads no torch, so that planning stays fast."""

from pathlib import Path

from lagsplat.config import ConfigError
from lagsplat.planning import Overrides, Run, compose_for, key_of, shared_experiment
from lagsplat.views.rig import read_rig

SUFFIX = "_3d"
SHORT = {"rainbow_rocker": "rocker"}
"""How figures call a system whose name is long."""


def planned_spatial(overrides: Overrides) -> dict[str, Run]:
    """The run behind each figure in space, by the figure's name.

    Left out are systems whose simulated views do not suit a filmed recording, and, where a user chooses
    ``systems`` and not ``spatial``, all that are not among these.

    Raises:
        ConfigError: see `lagsplat.config.compose`; also a system without novel views.
    """
    experiment = shared_experiment(overrides)
    chosen = {key_of(item) for item in overrides.shared}
    runs = {}
    for system in experiment.spatial:
        if "systems" in chosen and "spatial" not in chosen and system not in experiment.systems:
            continue
        own = compose_for(overrides, system=system)
        if own.views is None:
            raise ConfigError(
                f"spatial={experiment.spatial}: {system} has no novel views and its Gaussians live in the "
                f"picture; give it some, for instance hydra_{system}='views=sharp', or leave it out"
            )
        if own.views.kind == "simulated" and own.recording.kind != "simulated":
            continue
        name = system.removesuffix(SUFFIX)
        place = (own.choices["profile"], own.choices["recording"], system, own.choices["stage1"])
        runs[SHORT.get(name, name)] = Run(
            *place, own.autoencoder_seeds[0], own.choices["stage2"], own.seeds[0]
        )
    return runs


def files_of_rig(path: str) -> list[str]:
    """The JSON that describes a rig, and the films of its cameras.

    Raises:
        ConfigError: a file is missing, or the JSON is not a rig.
    """
    try:
        rig = read_rig(path)
    except (OSError, ValueError) as error:
        raise ConfigError(f"views.rig={path}: {error}") from error
    return [str(Path(path).expanduser()), *(str(each.video) for each in rig.others)]
