"""Parameters in the YAML files of MuJoCo's identification toolbox, `mujoco.sysid`: its `ParameterDict`."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from lagsplat.io.files.atomic import write_text

FIELDS = ("name", "nominal", "min_value", "max_value", "value", "frozen")


@dataclass(frozen=True)
class SysidParameter:
    """A parameter with its start, its value and its bounds, each of one shape; a frozen one is not fitted."""

    name: str
    nominal: np.ndarray
    value: np.ndarray
    low: np.ndarray
    high: np.ndarray
    frozen: bool = False


def read_sysid_parameters(path: Path) -> tuple[SysidParameter, ...]:
    """Read what `ParameterDict.save_to_disk` wrote; nothing in it is executed.

    Raises:
        FileNotFoundError: there is no file at ``path``.
        ValueError: no YAML, or no parameters; the message names the entry.
    """
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file; check the path")
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise ValueError(f"{path}: no YAML that holds plain data ({error}); save it again") from error
    if not isinstance(content, dict) or not content:
        raise ValueError(f"{path}: no parameters; give what ParameterDict.save_to_disk of mujoco.sysid wrote")
    return tuple(_read_parameter(path, str(key), entry) for key, entry in content.items())


def _read_parameter(path: Path, key: str, entry: Any) -> SysidParameter:
    missing = [name for name in FIELDS if not isinstance(entry, dict) or name not in entry]
    if missing:
        lacking = f"parameter {key!r} lacks {', '.join(missing)}"
        raise ValueError(f"{path}: {lacking}; give what ParameterDict.save_to_disk of mujoco.sysid wrote")
    try:
        numbers = {name: np.atleast_1d(np.asarray(entry[name], dtype=np.float64)) for name in FIELDS[1:5]}
    except (ValueError, TypeError) as error:
        raise ValueError(f"{path}: parameter {key!r} holds no numbers ({error}); correct it") from error
    shapes = {name: value.shape for name, value in numbers.items()}
    if len(set(shapes.values())) > 1 or not np.isfinite(numbers["value"]).all():
        raise ValueError(
            f"{path}: parameter {key!r} has shapes {shapes} and the value {entry['value']}; correct it"
        )
    nominal, low, high, value = numbers.values()
    return SysidParameter(str(entry["name"]), nominal, value, low, high, bool(entry["frozen"]))


def write_sysid_parameters(path: Path, parameters: Sequence[SysidParameter]) -> None:
    """Write parameters, which `ParameterDict.load_from_disk` loads.

    Raises:
        OSError: ``path`` cannot be written.
    """
    content = {
        each.name: {
            "name": each.name,
            "nominal": each.nominal.tolist(),
            "min_value": each.low.tolist(),
            "max_value": each.high.tolist(),
            "value": each.value.tolist(),
            "frozen": each.frozen,
        }
        for each in parameters
    }
    write_text(path, yaml.safe_dump(content, default_flow_style=False, sort_keys=False))
