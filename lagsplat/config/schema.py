"""Names and types of everything in ``conf/``: the groups, their choices, and the whole experiment."""

from dataclasses import dataclass

from lagsplat.baselines.config import AuthorsConfig, BaselineConfig, ForecasterConfig, OdeConfig
from lagsplat.chart.config import ChartConfig
from lagsplat.diagnose.core.config import DiagnoseConfig
from lagsplat.evaluate.config import EvaluateConfig, ExtrapolationConfig
from lagsplat.forces.config import ForcesConfig
from lagsplat.io.config import RecordingConfig
from lagsplat.io.files.tracking import require_tracking
from lagsplat.matter.config import MatterConfig
from lagsplat.project import find_project
from lagsplat.setting_checks import require_least
from lagsplat.stage1.config import PlanarDecoderConfig, RenderConfig, Stage1Config
from lagsplat.stage2.config import Stage2Config
from lagsplat.systems.config import PlantedRecordingsConfig, ReleaseConfig, SimulationConfig
from lagsplat.viewer.config import ViewerConfig
from lagsplat.views.config import ViewsConfig

CONF = find_project() / "conf"
GROUPS = (
    *("profile", "recording", "system", "simulation", "release", "stage1", "chart", "matter", "stage2"),
    "baseline",
    *("forecaster", "ode", "authors", "deformation", "evaluate", "extrapolation", "forces", "render"),
    *("views", "diagnose", "blind", "calibration", "planted", "viewer"),
)


def options(group: str) -> list[str]:
    """Names of the choices in ``conf/<group>/``: the closed vocabulary of a wildcard.

    A file ``base.yaml`` holds what several choices share and is none itself.
    """
    return sorted(path.stem for path in (CONF / group).glob("*.yaml") if path.stem != "base")


@dataclass  # not frozen: OmegaConf turns frozen dataclasses into read-only nodes
class SystemConfig:
    """What is known of a mechanism before anything is learned."""

    title: str  # how captions and tables call it
    film_kind: str  # of its filmed recording: `krauss` or `video`
    d: int  # latent dimension: its number of degrees of freedom
    n_gaussians: int
    batch: int  # frames a step of stage 1: fewer where frames are large
    encoder_rate: float  # step size of the encoder in stage 1: smaller where fast steps would bend the chart

    def __post_init__(self) -> None:
        """Check the counts; stage 1 checks them again where they are used."""
        for name in ("d", "n_gaussians", "batch"):
            if getattr(self, name) < 1:
                raise ValueError(f"system.{name}={getattr(self, name)} must be at least 1")


@dataclass  # not frozen, for the same reason
class BlindConfig:
    """A sealed split of the benchmark, and who predicts it."""

    split: str  # name of the split. A revealed one is spent; another name draws another split.
    keys: str  # folder of the secret keys, one a split, outside of everything that a prediction may read
    systems: str  # group of mechanisms that the generator draws from
    t0: int  # recordings that are trajectories [count]; 0 leaves this tier out
    t1: int  # recordings that are videos [count]; 0 leaves this tier out
    film_steps: int  # steps of stage 1 on each nominal video [count]
    film_gaussians: int  # Gaussians that render it [count]
    batch: int  # recordings in a job [count]
    left_out: int  # recordings diagnosed again without their effect in the catalogue, at most [count]
    baselines: list[str]  # other methods in the table
    reveal: bool  # write the outcome of every recording, after which the split is spent

    def __post_init__(self) -> None:
        require_least(self, "blind", 0, "t0", "t1", "left_out")
        if self.t0 + self.t1 == 0:
            raise ValueError("blind.t0=0 and blind.t1=0 leave no recording; give one of them a number")
        require_least(self, "blind", 1, "batch", "film_steps", "film_gaussians")
        if not self.split.replace("-", "").isalnum():
            raise ValueError(f"blind.split={self.split!r} names a folder; take letters, digits and hyphens")


@dataclass  # not frozen, for the same reason
class CalibrationConfig:
    """Recordings whose truth is known, on which the probabilities of a verdict are fitted."""

    recordings: int  # recordings in all [count]
    batch: int  # recordings in a job [count]
    seed: str  # word that all draws follow from
    systems: str  # group of mechanisms that the generator draws from

    def __post_init__(self) -> None:
        require_least(self, "calibration", 1, "recordings", "batch")


@dataclass  # not frozen, for the same reason
class Config:
    """An experiment. Every value comes from ``conf/`` or from an override, none from here."""

    systems: list[str]  # systems of the tables and figures
    ablations: list[str]  # choices of `conf/stage2` that get a row beside the chosen dynamics
    baselines: list[str]  # choices of `conf/baseline` that get a row in the benchmark table of the arms
    baseline_seeds: list[int]  # seeds of the baselines
    spatial: list[str]  # systems that are pushed in space: they have novel views
    extrapolated: list[str]
    """Systems of the table of extrapolation: they move freely, and the end of a clip is held out."""
    forecasters: list[str]  # choices of `conf/forecaster` that stand in it
    forecaster_seeds: list[int]  # seeds of the forecasters and of the neural differential equations
    odes: list[str]  # choices of `conf/ode`: laws of the same latents beside ours
    seeds: list[int]  # of a run each, for stage 1 and stage 2 alike
    tracking: str  # where the metrics of runs are kept besides: none, jsonl or mlflow
    choices: dict[str, str]  # name of the file chosen in each group; filled in by :func:`compose`
    system: SystemConfig
    recording: RecordingConfig
    simulation: SimulationConfig | None  # the simulated stand-in of a driven arm; null where there is none
    release: ReleaseConfig | None
    """The simulated stand-in of a mechanism that is let go; null where there is none."""
    stage1: Stage1Config
    chart: ChartConfig
    matter: MatterConfig
    stage2: Stage2Config
    baseline: BaselineConfig
    forecaster: ForecasterConfig
    ode: OdeConfig
    authors: AuthorsConfig
    deformation: PlanarDecoderConfig
    evaluate: EvaluateConfig
    extrapolation: ExtrapolationConfig
    forces: ForcesConfig  # how forces given in the image take hold, and which ones are shown and checked
    render: RenderConfig | None
    """A finer decoder for the figures; null draws them with the one that was trained."""
    views: ViewsConfig | None
    """Pictures from other sides, by which Gaussians live in space; null trains on the film alone."""
    diagnose: DiagnoseConfig
    blind: BlindConfig
    calibration: CalibrationConfig
    planted: PlantedRecordingsConfig
    viewer: ViewerConfig

    def __post_init__(self) -> None:
        """Check that every name and seed of the protocol can be run."""
        groups = {"systems": "system", "extrapolated": "system", "spatial": "system"}
        groups |= {"ablations": "stage2", "baselines": "baseline", "forecasters": "forecaster", "odes": "ode"}
        for key, group in groups.items():
            names = getattr(self, key)
            for name in names:
                if name not in options(group):
                    raise ValueError(f"{key}={names}: {name!r} is not one of {options(group)} (conf/{group})")
        for key in ("seeds", "baseline_seeds", "forecaster_seeds"):
            seeds = getattr(self, key)
            if not seeds or min(seeds) < 0 or len(set(seeds)) < len(seeds):
                raise ValueError(f"{key}={seeds} must be distinct integers, none negative, at least one")
        if not self.systems:
            raise ValueError(f"systems=[] leaves nothing to do; choose among {options('system')}")
        require_tracking(self.tracking)
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
