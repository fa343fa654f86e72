"""Sims that are models and no recordings: sampled where the real mechanism was seen."""

from collections.abc import Sequence
from pathlib import Path

from lagsplat.diagnose.augmented import load_augmented
from lagsplat.diagnose.mujoco_sim import sample_mujoco
from lagsplat.diagnose.python_sim import load_python, sample_python
from lagsplat.diagnose.region import Region
from lagsplat.diagnose.sample import Sampled
from lagsplat.diagnose.sources import find_sources


def sampled_sim(
    name: str,
    region: Region,
    *,
    joints: Sequence[str] | None = None,
    actuators: Sequence[str] | None = None,
) -> Sampled:
    """The model that ``sim=name`` gives over a region, with the error of its acceleration there.

    Of an augmented sim its own model is taken, without the effects.

    Raises:
        FileNotFoundError: nothing is there.
        ValueError: it is a recording, or does not fit the region's coordinates and inputs.
    """
    source, *more = find_sources(name)
    if more:
        raise ValueError(f"sim={name}: {1 + len(more)} things; name one model")
    if source.kind == "mujoco":
        return sample_mujoco(Path(source.path), region, joints=joints, actuators=actuators)
    if source.kind == "python":
        return sample_python(load_python(source.path), region, what=source.path)
    if source.kind == "run":
        from lagsplat.diagnose.run_sim import open_dynamics, sample_run  # torch, which the others do without

        return sample_run(open_dynamics(Path(source.path)), region, what=source.path)
    if source.kind == "model":
        return Sampled(load_augmented(source.path).model, 0.0)
    raise ValueError(f"{source.path}: a recording, which is identified and not sampled")
