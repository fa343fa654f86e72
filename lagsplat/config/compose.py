"""One experiment, composed once and typed: the only module that knows Hydra.

``conf/`` holds values, the dataclasses of the stages hold types and domains, and this module joins the two.
It loads neither torch nor numba, so that planning a workflow stays fast.
"""

import difflib
import re
from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeVar

from hydra import compose as hydra_compose
from hydra import initialize_config_dir
from hydra.core.config_store import ConfigStore
from hydra.errors import HydraException
from omegaconf import OmegaConf, open_dict
from omegaconf.errors import OmegaConfBaseException

from lagsplat.baselines.config import AuthorsConfig, BaselineConfig, ForecasterConfig, OdeConfig
from lagsplat.chart.config import ChartConfig
from lagsplat.diagnose.core.blind_config import BlindConfig
from lagsplat.diagnose.core.config import DiagnoseConfig
from lagsplat.evaluate.config import EvaluateConfig, ExtrapolationConfig
from lagsplat.forces.config import ForcesConfig
from lagsplat.io.config import RecordingConfig
from lagsplat.stage1.config import FieldConfig, RenderConfig, Stage1Config
from lagsplat.stage2.config import Stage2Config
from lagsplat.systems.config import PlantsConfig, ReleaseConfig, SimulationConfig
from lagsplat.viewer.config import ViewerConfig
from lagsplat.views.config import ViewsConfig

CONF = Path(__file__).resolve().parents[2] / "conf"
GROUPS = (
    "profile",
    "recording",
    "system",
    "simulation",
    "release",
    "stage1",
    "chart",
    "stage2",
    "baseline",
    "forecaster",
    "ode",
    "authors",
    "deformation",
    "evaluate",
    "extrapolation",
    "forces",
    "render",
    "views",
    "diagnose",
    "blind",
    "planted",
    "viewer",
)
OPEN_TABLES = ("diagnose.columns",)
"""Tables of ``conf/`` whose keys are the user's own."""
Section = TypeVar("Section")


class ConfigError(ValueError):
    """A configuration that cannot be run; the message names the key, where it stands and the remedy."""


@dataclass  # not frozen: OmegaConf turns frozen dataclasses into read-only nodes
class SystemConfig:
    """What is known of a mechanism before anything is learned."""

    title: str
    """How captions and tables call it."""
    film: str
    """Kind of its filmed recording: ``krauss`` or ``video``."""
    d: int
    """Latent dimension: its number of degrees of freedom."""
    n_gaussians: int
    batch: int
    """Frames a step of stage 1: fewer where frames are large."""
    encoder_rate: float
    """Step size of the encoder in stage 1: smaller where fast steps would bend the chart."""

    def __post_init__(self) -> None:
        """Check the counts; stage 1 checks them again where they are used."""
        if min(self.d, self.n_gaussians, self.batch) < 1:
            raise ValueError(
                f"system.d={self.d}, system.n_gaussians={self.n_gaussians} and system.batch={self.batch} "
                "must be at least 1"
            )


@dataclass  # not frozen, for the same reason
class Config:
    """An experiment. Every value comes from ``conf/`` or from an override, none from here."""

    systems: list[str]
    """Systems of the tables and figures."""
    ablations: list[str]
    """Choices of ``conf/stage2`` that get a row beside the chosen dynamics."""
    baselines: list[str]
    """Choices of ``conf/baseline`` that get a row in the benchmark table of the arms."""
    baseline_seeds: list[int]
    """Seeds of the baselines."""
    spatial: list[str]
    """Systems that are pushed in space: they have novel views."""
    extrapolated: list[str]
    """Systems of the table of extrapolation: they move freely, and the end of a clip is held out."""
    forecasters: list[str]
    """Choices of ``conf/forecaster`` that stand in it."""
    forecaster_seeds: list[int]
    """Seeds of the forecasters and of the free differential equation."""
    autoencoder_seeds: list[int]
    """Seeds of stage 1."""
    seeds: list[int]
    """Seeds of stage 2, for each autoencoder."""
    choices: dict[str, str]
    """Name of the file chosen in each group; filled in by :func:`compose`."""
    system: SystemConfig
    recording: RecordingConfig
    simulation: SimulationConfig | None
    """The simulated stand-in of a driven arm; null where there is none."""
    release: ReleaseConfig | None
    """The simulated stand-in of a mechanism that is let go; null where there is none."""
    stage1: Stage1Config
    chart: ChartConfig
    stage2: Stage2Config
    baseline: BaselineConfig
    forecaster: ForecasterConfig
    ode: OdeConfig
    authors: AuthorsConfig
    deformation: FieldConfig
    evaluate: EvaluateConfig
    extrapolation: ExtrapolationConfig
    forces: ForcesConfig
    """How forces given in the image take hold, and which ones are shown and checked."""
    render: RenderConfig | None
    """A finer decoder for the figures; null draws them with the one that was trained."""
    views: ViewsConfig | None
    """Pictures from other sides, by which Gaussians live in space; null trains on the film alone."""
    diagnose: DiagnoseConfig
    blind: BlindConfig
    planted: PlantsConfig
    """Effects to be found again: what the second recordings of a simulated arm have."""
    viewer: ViewerConfig

    def __post_init__(self) -> None:
        """Check that every name and seed of the protocol can be run."""
        for key, names, group in (
            ("systems", self.systems, "system"),
            ("ablations", self.ablations, "stage2"),
            ("baselines", self.baselines, "baseline"),
            ("extrapolated", self.extrapolated, "system"),
            ("spatial", self.spatial, "system"),
            ("forecasters", self.forecasters, "forecaster"),
        ):
            for name in names:
                if name not in options(group):
                    raise ValueError(f"{key}={names}: {name!r} is not one of {options(group)} (conf/{group})")
        for key, seeds in (
            ("autoencoder_seeds", self.autoencoder_seeds),
            ("seeds", self.seeds),
            ("baseline_seeds", self.baseline_seeds),
            ("forecaster_seeds", self.forecaster_seeds),
        ):
            if not seeds or min(seeds) < 0 or len(set(seeds)) < len(seeds):
                raise ValueError(f"{key}={seeds} must be distinct integers, none negative, at least one")
        if not self.systems:
            raise ValueError(f"systems=[] leaves nothing to do; choose among {options('system')}")
        self._check_source()

    def _check_source(self) -> None:
        system, recording = self.choices["system"], self.recording
        if self.simulation is not None and self.release is not None:
            raise ValueError(f"conf/system/{system}.yaml has a simulation and a release; set one to null")
        if recording.kind == "simulated" and self.simulation is None and self.release is None:
            raise ValueError(
                f"recording=simulated: conf/system/{system}.yaml has no simulation and no release; "
                "give recording=filmed recording.path=FILE, or another system"
            )
        if recording.kind != "simulated" and recording.path is None and recording.archive is None:
            raise ValueError(
                f"recording.path=null: {system} is filmed and no public archive holds it; "
                "give recording.path=FILE"
            )


def options(group: str) -> list[str]:
    """Names of the choices in ``conf/<group>/``: the closed vocabulary of a wildcard."""
    return sorted(path.stem for path in (CONF / group).glob("*.yaml"))


@lru_cache(maxsize=256)
def compose(*overrides: str) -> Config:
    """The experiment that ``conf/`` and these Hydra overrides describe, typed and checked.

    Of two choices for the same group the last one wins. The result is shared between callers and must not
    be changed.

    Raises:
        ConfigError: an unknown key or choice, a value of the wrong type or outside its domain.
    """
    for item in overrides:
        if not re.match(r"[A-Za-z_][\w.]*=", item):
            raise ConfigError(f"override {item!r} is not key=value; only keys that exist in conf/ can be set")
    ConfigStore.instance().store(name="schema", node=Config)
    # Hydra refuses two choices for one group; the last one wins here, so that a path can overrule a user.
    kept = list({key_of(item): item for item in overrides}.values())
    try:
        with initialize_config_dir(str(CONF), version_base="1.3"):
            tree = hydra_compose("config", [_opened(item) for item in kept], return_hydra_config=True)
        choices = {group: str(tree.hydra.runtime.choices[group]) for group in GROUPS}
        with open_dict(tree):
            tree.pop("hydra")
        tree.choices = choices
        experiment = OmegaConf.to_object(tree)
    except (HydraException, OmegaConfBaseException, ValueError) as error:
        raise ConfigError(_explain(error, kept)) from error
    assert isinstance(experiment, Config)
    return experiment


def key_of(override: str) -> str:
    """The key that an override ``key=value`` sets."""
    return override.partition("=")[0]


def _opened(override: str) -> str:
    """The override in Hydra's words: a table whose keys the user chooses takes keys that conf/ lacks."""
    key = override.partition("=")[0]
    free = any(key == name or key.startswith(f"{name}.") for name in OPEN_TABLES)
    return f"++{override}" if free else override


def rebuild(schema: type[Section], values: Mapping[str, Any]) -> Section:
    """A section of the configuration from plain data, checked again.

    Raises:
        ConfigError: values that do not fit the section, for instance of an artefact of another version.
    """
    try:
        tree = OmegaConf.merge(OmegaConf.structured(schema), dict(values))
        return OmegaConf.to_object(tree)  # type: ignore[return-value]
    except (OmegaConfBaseException, ValueError) as error:
        raise ConfigError(f"{schema.__name__}: {error}") from error


def _explain(error: BaseException | None, overrides: list[str]) -> str:
    """Turn the composer's chain of errors into what was found, where, and what to do."""
    parts = []
    while error is not None:
        if (text := " ".join(str(error).split())) not in parts:
            parts.append(text)
        error = error.__cause__
    text = re.sub(
        r" ?(To append to your config|Config search path:|Set the environment).*?(?= \| |$)",
        "",
        " | ".join(parts),
    )
    text = re.sub(r" (full_key|reference_type|object_type)[:=]", r"; \1:", text)
    text = re.sub(r"In '([\w/]+)'", r"conf/\1.yaml", text)
    if found := re.search(r"Key '(\w+)' (?:is )?not in '(\w+)'", text):
        known = _keys_of(found[2])
        text += f". Unknown key {found[1]!r}{closest(found[1], known)}; known: {', '.join(known)}"
    elif found := re.search(r"(?:full_key: |override '?)(\w+)[.=]", text):
        text += f". Values in use: conf/{found[1]}"
    return text + (f" [overrides: {' '.join(overrides)}]" if overrides else "")


def _keys_of(name: str) -> list[str]:
    """Fields of the configuration class ``name``, wherever it stands below :class:`Config`."""
    waiting: list[type] = [Config]
    while waiting:
        schema = waiting.pop()
        if schema.__name__ == name:
            return [field.name for field in fields(schema)]
        kinds = [kind for f in fields(schema) for kind in (f.type, *getattr(f.type, "__args__", ()))]
        waiting += [kind for kind in kinds if isinstance(kind, type) and is_dataclass(kind)]
    return []


def closest(word: str, known: list[str]) -> str:
    """A hint at the known word nearest to a misspelt one, or nothing where none is near."""
    near = difflib.get_close_matches(word, known, n=1)
    return f" (did you mean {near[0]!r}?)" if near else ""
