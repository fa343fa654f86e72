"""Diagnose data in memory or on disk, and show what was found: `lagsplat.diagnose`."""

import html
import os
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from lagsplat.config.compose import ConfigError, closest, compose
from lagsplat.diagnose.core.result import Candidate, Diagnosis
from lagsplat.io.trajectory.trajectory import Trajectory
from lagsplat.pipelines.diagnosis import diagnose_files
from lagsplat.report.diagnosis import serialization
from lagsplat.report.diagnosis.figure_hypotheses import draw_posterior
from lagsplat.report.diagnosis.figure_residual import draw_forecast_comparison, draw_time_strip
from lagsplat.report.diagnosis.summary import select_chosen, write_summary

PathLike = str | os.PathLike[str]
Motion = PathLike | pd.DataFrame | Trajectory | Mapping[str, Any] | np.ndarray
FIGURES = {"candidates": draw_posterior, "forecasts": draw_forecast_comparison, "time": draw_time_strip}


@dataclass(frozen=True, repr=False)
class DiagnosisReport(Diagnosis):
    """A diagnosis that shows itself: in words, as a figure, or as its whole report in a notebook.

    ``verdict`` is ``effect``, ``none``, ``unknown`` or ``undetermined``; ``gap`` holds the errors of held-out
    forecasts, in fractions of each coordinate's rms, before and after the effects are added.

    Example:
        >>> import lagsplat
        >>> diagnosis = lagsplat.load_diagnosis("diagnosis")
        >>> diagnosis.verdict in ("effect", "none", "unknown", "undetermined")
        True
    """

    page: str = field(default="", repr=False)
    """The report, as one HTML page."""

    @classmethod
    def of(cls, diagnosis: Diagnosis, page: str) -> Self:
        """The same diagnosis with its page."""
        return cls(**{item.name: getattr(diagnosis, item.name) for item in fields(diagnosis)}, page=page)

    @property
    def effects(self) -> tuple[Candidate, ...]:
        """The effects that together explain the gap, with their fitted parameters; empty where none does."""
        return tuple(select_chosen(self))

    def plot(self, kind: Literal["candidates", "forecasts", "time"] = "candidates") -> Figure:
        """Draw how probable each candidate is, the held-out forecasts, or one of them over time.

        Raises:
            ValueError: an unknown kind, or a diagnosis that holds nothing of it.
        """
        if kind not in FIGURES:
            raise ValueError(f"no figure {kind!r}; choose one of {', '.join(FIGURES)}")
        figure = FIGURES[kind](self)
        if figure is None:
            raise ValueError(f"nothing was held out, so there is no figure of {kind}; record longer")
        return figure

    def __repr__(self) -> str:
        return f"<Diagnosis: {write_summary(self)}>"

    def _repr_html_(self) -> str:
        if not self.page:
            return f"<p>{html.escape(write_summary(self))}</p>"
        return (
            f'<iframe srcdoc="{html.escape(self.page)}" title="Diagnosis" '
            'style="width: 100%; height: 48rem; border: 0"></iframe>'
        )


def diagnose(
    sim: Motion | Sequence[Motion],
    real: Motion | Sequence[Motion],
    *,
    out: PathLike | None = None,
    **settings: Any,
) -> DiagnosisReport:
    """Name the physical effects by which a real mechanism differs from its simulator.

    Args:
        sim: The simulator: its trajectories, a MuJoCo ``.xml``, ``"file.py:attribute"``, the folder of a
            fitted run, or a film, to which a run is fitted first (``film_d=2`` for two coordinates) and kept.
            A ``.py`` file is a program of yours, and runs. Trajectories are files (CSV, Parquet, NPZ, MAT,
            HDF5, MCAP), LeRobot datasets, DataFrames or mappings with columns ``t`` [s], ``q0, q1, ...`` and
            inputs ``u0, ...``; or ``t`` (T,), ``q`` (T, d) and ``u`` (T, n_u).
            An array (T, 1 + d) holds time and coordinates; a mechanism with inputs needs named columns.
        real: Trajectories of the real mechanism, likewise; films where the sim is a film or a run.
        out: Folder for ``diagnosis.json``, ``report.html`` and the augmented simulator; without it nothing
            is kept.
        settings: Fields of ``conf/diagnose``, such as ``iterations=6`` or ``columns={"q0": "angle"}``.

    Returns:
        The diagnosis: ``.verdict``, ``.effects``, ``.gap`` and ``.plot()``; in a notebook, its report.

    Raises:
        FileNotFoundError: a file is not there.
        ValueError: data that cannot be compared, or an unknown setting.

    Example:
        >>> import lagsplat, pandas
        >>> few = ("viscous_damping", "coulomb_friction", "constant_force")
        >>> others = [effect.name for effect in lagsplat.effects() if effect.name not in few]
        >>> quick = dict(without=others, places=1, starts=1, iterations=2, identify_iterations=4)
        >>> found = lagsplat.diagnose("sim.csv", pandas.read_csv("real.csv"), **quick)
        >>> found.candidates[0].probability > 0
        True
    """
    config = compose().diagnose
    known = [item.name for item in fields(config)]
    if unknown := [name for name in settings if name not in known]:
        raise ConfigError(f"diagnose: no setting {unknown[0]!r}{closest(unknown[0], known)}")
    config = replace(config, **settings)
    with tempfile.TemporaryDirectory() as scratch:
        kept = Path(scratch)
        folder = kept / "diagnosis" if out is None else Path(out).expanduser()
        sims, reals = _name_sources(sim, kept, "sim"), _name_sources(real, kept, "real")
        diagnosis = diagnose_files(sims, reals, folder, config, command="lagsplat.diagnose(sim, real)")
        page = (folder / "report.html").read_text(encoding="utf-8")
    return DiagnosisReport.of(diagnosis, page)


def load_diagnosis(path: PathLike) -> DiagnosisReport:
    """Read a diagnosis back from its folder, or from its ``diagnosis.json``.

    Raises:
        FileNotFoundError: no ``diagnosis.json`` is there.
        ValueError: the file is no diagnosis.

    Example:
        >>> import lagsplat
        >>> lagsplat.load_diagnosis("diagnosis").gap.horizon_s > 0
        True
    """
    path = Path(path).expanduser()
    path = path / "diagnosis.json" if path.is_dir() else path
    report = path.parent / "report.html"
    page = report.read_text(encoding="utf-8") if report.is_file() else ""
    return DiagnosisReport.of(serialization.load_diagnosis(path), page)


def _name_sources(data: Motion | Sequence[Motion], scratch: Path, name: str) -> str:
    """What `diagnose_files` is told: names of files, written first where data are in memory."""
    if isinstance(data, str | os.PathLike):
        return os.fspath(data)
    if isinstance(data, list | tuple):
        parts = [_name_sources(item, scratch, f"{name}{number}") for number, item in enumerate(data)]
        return "[" + ",".join(f'"{part}"' for part in parts) + "]"
    path = scratch / f"{name}.csv"
    to_table(data).to_csv(path, index=False)
    return str(path)


def to_table(data: Any) -> pd.DataFrame:
    """Columns ``t``, ``q0, ...`` and ``u0, ...`` of a trajectory in memory, in any form `diagnose` takes.

    Raises:
        ValueError: it is none of these forms.
    """
    if isinstance(data, pd.DataFrame):
        return data
    if isinstance(data, Trajectory):
        data = {"t": data.time_s, "q": data.q, "u": data.u}
    if isinstance(data, np.ndarray):
        if data.dtype.names:
            return pd.DataFrame(data)
        if data.ndim != 2 or data.shape[1] < 2:
            raise ValueError(f"an array of shape {data.shape}: give (T, 1 + d), its first column time [s]")
        data = {"t": data[:, 0], "q": data[:, 1:]}
    if not isinstance(data, Mapping):
        raise ValueError(
            f"{type(data).__name__} is no trajectory: give a file, a DataFrame, an array (T, 1 + d), "
            "or a mapping with t, q and u"
        )
    columns: dict[str, np.ndarray] = {}
    for name, values in data.items():
        array = np.asarray(values)
        if array.ndim == 2:
            columns |= {f"{name}{number}": column for number, column in enumerate(array.T)}
        else:
            columns[f"{name}0" if name in ("q", "u", "v") else name] = array
    return pd.DataFrame(columns)
