"""What ``sim=`` may be, and how each becomes a `Model`; sims known by recordings alone are identified."""

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from lagsplat.diagnose.mujoco_sim import sample_mujoco
from lagsplat.diagnose.python_sim import is_python_sim, load_python, sample_python
from lagsplat.diagnose.region import Region
from lagsplat.diagnose.sample import Sampled

Kind = Literal["mujoco", "python", "run", "recording"]


def sim_kind(name: str) -> Kind:
    """A MuJoCo file (``.xml``, ``.mjcf``), a Python attribute, the folder of a fitted run, or a recording."""
    if Path(name).suffix.lower() in (".xml", ".mjcf"):
        return "mujoco"
    if is_python_sim(name) and not Path(name).exists():
        return "python"
    return "run" if Path(name).is_dir() else "recording"


def sampled_sim(
    name: str,
    region: Region,
    *,
    joints: Sequence[str] | None = None,
    actuators: Sequence[str] | None = None,
) -> Sampled:
    """The model of a sim that is not given by recordings, over a region of states and inputs.

    Raises:
        FileNotFoundError: nothing is there.
        ValueError: the sim is one of recordings, or does not fit the region's coordinates and inputs.
    """
    kind = sim_kind(name)
    if kind == "mujoco":
        return sample_mujoco(Path(name), region, joints=joints, actuators=actuators)
    if kind == "python":
        return sample_python(load_python(name), region, what=name)
    if kind == "run":
        from lagsplat.diagnose.run_sim import open_dynamics, sample_run  # torch, which the others do without

        return sample_run(open_dynamics(Path(name)), region, what=name)
    raise ValueError(f"{name}: a recording; it is identified and not sampled")
