"""Which runs each table and figure of an experiment is made of, as the wildcards of their paths."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass, is_dataclass
from operator import attrgetter
from typing import Any

from lagsplat.baselines.config import BASELINE_TITLES
from lagsplat.config.schema import Config
from lagsplat.planning.plan import (
    FIGURE_NAMES,
    Overrides,
    compose_for,
    planned_baselines,
    planned_extrapolations,
    planned_masses,
    planned_recipes,
    planned_runs,
    planned_spatial,
    shared_experiment,
)

Wildcards = Mapping[str, Any]
Run = dict[str, Any]
CHOICES = ("profile", "recording", "system", "stage1", "stage2", "baseline", "forecaster", "ode")
LARGE_BATCH = 16  # frames of a step, which the rasteriser shares out: with fewer a second core would idle
MOST_THREADS = 8
SYSTEMS_OF_FIGURES = {name: system for system, name in FIGURE_NAMES.items()}


@dataclass(frozen=True)
class ExperimentPlan:
    """The runs that an experiment asks for. Each is a dict of wildcards; none is made here."""

    overrides: Overrides

    @property
    def experiment(self) -> Config:
        """The configuration that all runs share."""
        return shared_experiment(self.overrides)

    def section(self, name: str, **fixed: str) -> Callable[[Wildcards], Any]:
        """A function of wildcards: the part ``name`` of that job's configuration, as plain data."""

        def resolve(wildcards: Wildcards) -> Any:
            part = attrgetter(name)(compose_for(self.overrides, **list_choices(wildcards), **fixed))
            return asdict(part) if is_dataclass(part) and not isinstance(part, type) else part

        return resolve

    def runs(self, **chosen: str) -> list[Run]:
        """Every planned run, or those with the chosen wildcards."""
        every = [asdict(run) for run in planned_runs(self.overrides)]
        return [run for run in every if chosen.items() <= run.items()]

    def krauss_runs(self) -> list[Run]:
        """Runs of the pneumatic arms, whose benchmark has a table of its own."""
        return [run for run in self.runs() if self.section("system.film_kind")(run) == "krauss"]

    def main_runs(self) -> list[Run]:
        """Runs of the dynamics that a system is shown with, hence no ablation."""
        own = {
            name: compose_for(self.overrides, system=name).choices["stage2"]
            for name in self.experiment.systems
        }
        return [run for run in self.runs() if run["stage2"] == own[run["system"]]]

    def true_runs(self) -> list[Run]:
        """Those among them of which the truth is known, because they are simulated."""
        return [run for run in self.main_runs() if run["recording"] == "simulated"]

    def ode_runs(self) -> list[Run]:
        """Every differential equation over the image models of the arms."""
        return [
            {**model, "ode": ode, "seed": model["ae"]}
            for model in list_image_models(self.krauss_runs())
            for ode in dict.fromkeys(self.section("odes")(model))
        ]

    def models_of(self, system: str) -> tuple[list[Run], list[Run], list[Run], list[Run]]:
        """Every seed of all that forecasts a system.

        Runs without ablations, their image models, the differential equations over these, and the baselines.
        """
        runs = [run for run in self.main_runs() if run["system"] == system]
        odes, baselines = (
            [run for run in every if run["system"] == system]
            for every in (self.ode_runs(), self.baseline_runs())
        )
        return runs, list_image_models(runs), odes, baselines

    def baseline_runs(self) -> list[Run]:
        """Every published baseline beside the arms."""
        return [asdict(run) for run in planned_baselines(self.overrides)]

    def count_stage1_threads(self, wildcards: Wildcards, cores: int | None) -> int:
        """Threads of an image model: of small batches one, else its share of the cores.

        All models of the experiment run side by side: one that needs every core would wait behind jobs that
        need one.
        """
        if self.section("stage1.batch")(wildcards) < LARGE_BATCH:
            return 1
        models = len(list_image_models(self.runs()))
        return max(1, min(MOST_THREADS, (cores or MOST_THREADS) // max(1, models)))

    def first_baselines(self, system: str) -> list[Run]:
        """The baselines of one system with their first seed."""
        seed = self.experiment.baseline_seeds[0]
        return [run for run in self.baseline_runs() if run["system"] == system and run["seed"] == seed]

    def name_baselines(self, system: str) -> list[str]:
        """How figures call them."""
        names = [str(run["baseline"]) for run in self.first_baselines(system)]
        return [BASELINE_TITLES.get(name, name) for name in names]

    def systems_with_attention(self) -> list[str]:
        """Systems that have a baseline with attention maps."""
        return list_systems(run for run in self.baseline_runs() if "abcd" in run["baseline"])

    def describe_models(self, system: str) -> str:
        """What a figure of all models is of."""
        run = self.runs(system=system)[0]
        title = self.section("system.title")(run)
        return f"{title} · {run['recording']} recording · profile {run['profile']}"

    def titles(self, runs: Iterable[Run]) -> dict[str, str]:
        """How tables call the systems of these runs."""
        return {run["system"]: self.section("system.title")(run) for run in runs}

    def extrapolated(self) -> tuple[list[Run], list[Run]]:
        """Runs of the table of extrapolation, and the models beside them."""
        runs, others = planned_extrapolations(self.overrides)
        return [asdict(run) for run in runs], [{**asdict(run), run.kind: run.model} for run in others]

    def mass_runs(self) -> list[Run]:
        """Runs of the arms that differ in the form of their mass, ordered by it."""
        return [asdict(run) for run in planned_masses(self.overrides)]

    def first_masses(self, system: str) -> list[Run]:
        """Those of one system with its first seeds."""
        runs = [run for run in self.mass_runs() if run["system"] == system]
        return [run for run in runs if (run["ae"], run["seed"]) == (runs[0]["ae"], runs[0]["seed"])]

    def masses_are_ablations(self) -> bool:
        """Whether their table asks for no run that is not made anyway."""
        every, masses = self.runs(), self.mass_runs()
        return bool(masses) and all(run in every for run in masses)

    def recipe_runs(self) -> list[Run]:
        """Runs that differ in the settings of both stages, system by system."""
        return [asdict(run) for run in planned_recipes(self.overrides)]

    def pushable(self, runs: Iterable[Run]) -> list[Run]:
        """Those whose Gaussians live in the picture, as its forces do; others have figures in space."""
        return [run for run in runs if self.section("views")(run) is None]

    def pushed(self, mechanism: str) -> Run:
        """The run behind a figure of forces."""
        return self.runs(system=SYSTEMS_OF_FIGURES.get(mechanism, mechanism))[0]

    def pushed_mechanisms(self) -> list[str]:
        """Names of the figures of forces: systems that the paper pushes, or all where there are few."""
        flat = list_systems(self.pushable(self.main_runs()))
        return [FIGURE_NAMES[system] for system in flat if system in FIGURE_NAMES] or flat

    def pushed_runs(self) -> list[Run]:
        """Simulated runs whose answers to forces are compared with true ones, in the picture and in space."""
        truths = self.true_runs()
        runs = self.pushable(truths)
        for first in map(asdict, planned_spatial(self.overrides).values()):
            seeds = [run for run in truths if run["system"] == first["system"]]
            runs += seeds or [run for run in [first] if run["recording"] == "simulated"]
        return runs

    def diagnosed(self) -> list[Run]:
        """What is diagnosed: a run of every system against its own held-out part, and of every simulated arm
        against its second recordings."""
        runs = [run for run in self.main_runs() if run["seed"] == self.experiment.seeds[0]]
        arms = [
            run
            for run in runs
            if run["recording"] == "simulated" and self.section("simulation")(run) is not None
        ]
        return [{**run, "real": "held_out"} for run in runs] + [
            {**run, "real": effect} for run in arms for effect in self.experiment.planted.effects
        ]


def list_choices(wildcards: Wildcards) -> dict[str, str]:
    """The part of a path that names files in ``conf/``."""
    return {key: name for key, name in wildcards.items() if key in CHOICES}


def list_image_models(runs: Iterable[Run]) -> list[Run]:
    """Wildcards of every autoencoder of these runs, each once."""
    keys = ("profile", "recording", "system", "stage1", "ae")
    every = [{key: run[key] for key in keys} for run in runs]
    return [model for place, model in enumerate(every) if model not in every[:place]]


def list_systems(runs: Iterable[Run]) -> list[str]:
    """Systems of these runs, each once."""
    return list(dict.fromkeys(run["system"] for run in runs))
