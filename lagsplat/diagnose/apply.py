"""The effects of a diagnosis, added to a sim again."""

from collections.abc import Sequence
from pathlib import Path

from lagsplat.diagnose.augmented import Augmented, grafted, load_augmented, save_augmented
from lagsplat.diagnose.sims import sampled_sim
from lagsplat.diagnose.sources import find_sources
from lagsplat.io.artefact import read_header
from lagsplat.io.plain import load_json

FILE = "augmented.safetensors"


def apply(
    diagnosis: Path,
    sim: str | None,
    *,
    out: Path,
    joints: Sequence[str] | None = None,
    actuators: Sequence[str] | None = None,
) -> Augmented:
    """Add the effects that a ``diagnosis.json`` chose to ``sim``, and keep the result in ``out``.

    The fitted effects stand in the augmented sim beside the diagnosis. Without ``sim`` it is copied as it is,
    with the sim's own parameters as the diagnosis moved them; on another sim these stay what they are.

    Raises:
        FileNotFoundError: no diagnosis, or no augmented sim beside it.
        ValueError: the sim is one of recordings alone, or has other coordinates or inputs.
    """
    said = load_json(diagnosis)
    beside = diagnosis.parent / FILE
    if not beside.is_file():
        raise FileNotFoundError(
            f"{beside}: not there (verdict {said.get('verdict')!r}); keep the folder of a diagnosis "
            "together, or diagnose again"
        )
    one, header = load_augmented(beside), read_header(beside)
    if sim is not None:
        kinds = {source.kind for source in find_sources(sim)}
        if not kinds <= {"mujoco", "python", "run", "model"}:
            raise ValueError(
                f"sim={sim}: a sim known by its recordings was identified by the diagnosis and is in "
                f"{beside}; leave sim= out to get it with its effects"
            )
        found = sampled_sim(sim, one.region, joints=joints, actuators=actuators)
        one = grafted(one, found.model)
        header = {**header, "sim": sim, "sim_error": found.error}
    header.pop("stamp", None)
    save_augmented(out, one, {**header, "diagnosis": str(diagnosis)})
    return one
