from dataclasses import asdict, is_dataclass
from operator import attrgetter
from pathlib import Path

from lagsplat.project import use_project

PIPELINE = use_project(workflow.basedir)  # before the settings in it are looked for

from lagsplat.baselines.config import BASELINE_TITLES
from lagsplat.config.compose import ConfigError
from lagsplat.config.schema import options
from lagsplat.planning.plan import lineage
from lagsplat.planning.plan import (
    FIGURE_NAMES,
    SUFFIX,
    TRIVIAL,
    compose_for,
    files_of,
    files_of_rig,
    planned_baselines,
    planned_extrapolations,
    planned_masses,
    planned_recipes,
    planned_runs,
    planned_spatial,
    read_overrides,
    script_digest,
    shared_experiment,
    weights_of,
)
from lagsplat.processes import announce_driver
from lagsplat.provenance import let_waiting_threads_sleep

let_waiting_threads_sleep()  # the jobs inherit it
announce_driver()

# snakemake --config hydra="profile=full stage2.steps=9000" hydra_krauss_2seg="stage1=upstream"
try:
    overrides = read_overrides(config)
    experiment = shared_experiment(overrides)
    if workflow.is_main_process:  # all is checked once, before the first job
        planned_runs(overrides)
        planned_baselines(overrides)
        planned_extrapolations(overrides)
except ConfigError as error:
    raise WorkflowError(str(error))


onstart:
    if workflow.execution_settings.keep_incomplete:
        raise WorkflowError(
            "--keep-incomplete keeps what a failed job has left half made, and a later run would take it for whole; "
            "leave the option out: trainings go on from their checkpoint without it"
        )
    if not workflow.execution_settings.lock:
        raise WorkflowError(
            "--nolock lets two runs write the same results; leave the option out. If a run was killed and its lock is "
            "still there, run `snakemake --unlock` once"
        )


SYSTEMS_OF_FIGURES = {name: system for system, name in FIGURE_NAMES.items()}


wildcard_constraints:
    profile="|".join(options("profile")),
    recording="|".join(options("recording")),
    system="|".join(options("system")),
    stage1="|".join(options("stage1")),
    stage2="|".join(options("stage2")),
    baseline="|".join(options("baseline")),
    forecaster="|".join(options("forecaster")),
    ode="|".join(options("ode")),
    trial="[0-9]+",
    field="conditioned|deformed",
    # Figures in space end in the same way as the names of systems in space.
    mechanism="|".join(
        [
            *SYSTEMS_OF_FIGURES,
            *(name for name in options("system") if not name.endswith(SUFFIX)),
        ]
    ),
    solid="|".join(planned_spatial(overrides)),
    ae="[0-9]+",
    seed="[0-9]+",
    effect="|".join(experiment.planted.effects),
    real="held_out|" + "|".join(experiment.planted.effects),


SCRIPTS = PIPELINE / "workflow" / "scripts"


def choices(wildcards):
    """The part of a path that names files in conf/."""
    groups = (
        "profile",
        "recording",
        "system",
        "stage1",
        "stage2",
        "baseline",
        "forecaster",
        "ode",
    )
    return {key: name for key, name in wildcards.items() if key in groups}


def section(name, **fixed):
    """The resolved part ``name`` of a job's configuration, as plain data."""

    def resolve(wildcards):
        part = attrgetter(name)(compose_for(overrides, **choices(wildcards), **fixed))
        return asdict(part) if is_dataclass(part) else part

    return resolve


def before(stage):
    """Digest of the settings and code that made the inputs of a job."""
    return lambda wildcards: lineage(overrides, SCRIPTS, stage, **choices(wildcards))


def minutes(toy, quick, full):
    """Time limit of a training run, by profile; every further try has as much again, up to a day."""
    limits = {"toy": toy, "quick": quick, "full": full}
    return lambda wildcards, attempt: min(attempt * limits[wildcards.profile], 24 * 60)


def planned(**chosen):
    """Wildcards of every planned run, or of those with the chosen ones."""
    every = [asdict(run) for run in planned_runs(overrides)]
    return [run for run in every if chosen.items() <= run.items()]


def refined(wildcards):
    """Whether figures of this run are drawn by a finer decoder of their own."""
    return section("render")(wildcards) is not None


def krauss_runs():
    """Planned runs of the pneumatic arms, whose benchmark has a table of its own."""
    return [run for run in planned() if section("system.film")(run) == "krauss"]


def image_models(runs):
    """Wildcards of every autoencoder of these runs, each once."""
    keys = ("profile", "recording", "system", "stage1", "ae")
    every = [{key: run[key] for key in keys} for run in runs]
    return [model for place, model in enumerate(every) if model not in every[:place]]


def simple_predictors(chosen, output):
    """An input function: one output of the simple predictors for every autoencoder of the chosen runs."""
    return lambda wildcards: [
        rules.simple_predictors.output[output].format(**model)
        for model in image_models(chosen())
    ]


def ode_runs():
    """Wildcards of every differential equation over the autoencoders of the pneumatic arms."""
    return [
        {**model, "ode": ode, "seed": model["ae"]}
        for model in image_models(krauss_runs())
        for ode in dict.fromkeys(section("odes")(model))
    ]


def baseline_runs():
    """Wildcards of every baseline beside them."""
    return [asdict(run) for run in planned_baselines(overrides)]


def first_baselines(system):
    """Wildcards of the baselines of one system with their first seed."""
    seed = experiment.baseline_seeds[0]
    return [
        run
        for run in baseline_runs()
        if run["system"] == system and run["seed"] == seed
    ]


def baseline_files(system, output):
    """One output for each of them."""
    return [output.format(**run) for run in first_baselines(system)]


def baseline_names(system):
    """How figures call them."""
    return [
        BASELINE_TITLES.get(run["baseline"], run["baseline"])
        for run in first_baselines(system)
    ]


def shown_as(system):
    """What a figure of all models is of."""
    run = planned(system=system)[0]
    title = section("system.title")(run)
    return f"{title} · {run['recording']} recording · profile {run['profile']}"


def before_figures(system):
    """Digest of the settings and code behind all the models of a system."""
    return [
        before("evaluate")(planned(system=system)[0]),
        *(before("baseline_table")(run) for run in first_baselines(system)),
    ]


def extrapolated():
    """Wildcards of the runs of the table of extrapolation, and of the models beside them."""
    runs, others = planned_extrapolations(overrides)
    return [asdict(run) for run in runs], [
        {**asdict(run), run.kind: run.model} for run in others
    ]


def mass_runs():
    """Wildcards of the runs of the arms that differ in the form of their mass, ordered by it."""
    return [asdict(run) for run in planned_masses(overrides)]


def recipe_runs():
    """Wildcards of the runs that differ in the settings of both stages, system by system."""
    return [asdict(run) for run in planned_recipes(overrides)]


def first_masses(system):
    """Those of one system with its first seeds."""
    runs = [run for run in mass_runs() if run["system"] == system]
    seeds = [(run["ae"], run["seed"]) for run in runs]
    return [run for run, seed in zip(runs, seeds) if seed == seeds[0]]


def masses_are_ablations():
    """Whether their table asks for no run that is not made anyway."""
    every = planned()
    return bool(mass_runs()) and all(run in every for run in mass_runs())


def main_runs():
    """Planned runs of the dynamics that a system is shown with, hence no ablation."""
    own = {
        name: compose_for(overrides, system=name).choices for name in experiment.systems
    }
    return [run for run in planned() if run["stage2"] == own[run["system"]]["stage2"]]


def true_runs():
    """Those among them of which the truth is known, because they are simulated."""
    return [run for run in main_runs() if run["recording"] == "simulated"]


def pushable(runs):
    """Those among these whose Gaussians live in the picture, as its forces do; others have figures in space."""
    return [run for run in runs if section("views")(run) is None]


def pushed(mechanism):
    """The planned run behind a figure of forces."""
    return planned(system=SYSTEMS_OF_FIGURES.get(mechanism, mechanism))[0]


def pushed_mechanisms():
    """Names of the figures of forces: of the systems that the paper pushes, or of all where there are few."""
    flat = list(dict.fromkeys(run["system"] for run in pushable(main_runs())))
    return [FIGURE_NAMES[system] for system in flat if system in FIGURE_NAMES] or flat


def pushed_runs():
    """Simulated runs whose answers to forces are compared with true ones, in the picture and in space."""
    runs = pushable(true_runs())
    for first in map(asdict, planned_spatial(overrides).values()):
        seeds = [run for run in true_runs() if run["system"] == first["system"]]
        runs += seeds or [run for run in [first] if run["recording"] == "simulated"]
    return runs


def before_push(wildcards):
    """Digest of the settings and code that made a law and the matter that it moves."""
    return [before("evaluate")(wildcards), before("matter_paths")(wildcards)]


def forces_before(runs):
    """Digest of all that made the answers to forces of these runs."""
    return [
        [
            before_push(run),
            section("forces")(run),
            script_digest(SCRIPTS / "forces/forces.py"),
        ]
        for run in runs
    ]


def diagnosed():
    """What is diagnosed, with its wildcards: one run of every system against its own held-out part, and of
    every simulated arm against its second recordings."""
    runs = [run for run in main_runs() if run["seed"] == experiment.seeds[0]]
    arms = [
        run
        for run in runs
        if run["recording"] == "simulated" and section("simulation")(run) is not None
    ]
    return [{**run, "real": "held_out"} for run in runs] + [
        {**run, "real": effect} for run in arms for effect in experiment.planted.effects
    ]


def gathered(chosen, output):
    """An input function: one output of rule evaluate for all the runs that ``chosen`` gives."""

    def files(wildcards):
        if not chosen():
            kinds = {
                krauss_runs: "a pneumatic arm (system.film=krauss)",
                mass_runs: "a pneumatic arm (system.film=krauss)",
                true_runs: "simulated",
            }
            raise WorkflowError(
                f"this table would be empty: no system of systems={experiment.systems} is "
                f"{kinds[chosen]}; choose others with systems=[...], or make results/tables/physical.tex"
            )
        return [rules.evaluate.output[output].format(**run) for run in chosen()]

    return files


def titles(runs):
    """How tables call the systems of these runs."""
    return {run["system"]: section("system.title")(run) for run in runs}


def final_outputs():
    """What `snakemake` makes without a target: every table and figure that the experiment has runs for."""
    runs, arms, truths = planned(), krauss_runs(), true_runs()
    tables = [*rules.physical.output, *rules.margins.output, *rules.guarantee.output]
    tables += rules.force_invariants.output
    tables += rules.table.output if arms else []
    tables += rules.mass.output if masses_are_ablations() else []
    tables += rules.truth.output if truths else []
    tables += rules.force_truth.output if pushable(truths) else []
    return [*tables, *_figures(runs, arms, truths)]


def _figures(runs, arms, truths):
    mechanisms, solids = pushed_mechanisms(), planned_spatial(overrides)
    figures = [
        *expand(rules.force.output, mechanism=mechanisms),
        *expand(rules.force_map.output, mechanism=mechanisms if truths else []),
        *expand(rules.force_space.output, solid=solids),
        *expand(rules.figure.output, system=experiment.systems),
        *expand(
            [*rules.horizon.output, *rules.gallery.output], system=systems_of(arms)
        ),
        *expand(rules.attention.output, system=systems_with_attention()),
    ]
    if masses_are_ablations():
        figures += expand(rules.inertia.output, system=systems_of(mass_runs()))
    if extrapolated()[0]:
        for name in ("extrapolation", "equilibrium", "deformation", "jacobian_field"):
            figures += getattr(rules, name).output
    for name in ("curve", "reconstruction", "latent"):
        figures += filled(getattr(rules, name), runs)
    figures += filled(rules.baseline_curve, baseline_runs())
    return figures + filled(rules.sides, [asdict(run) for run in solids.values()])


def filled(rule, runs):
    """All outputs of a rule for each of these runs."""
    return [output.format(**run) for run in runs for output in rule.output]


def drawn():
    """The pictures among them."""
    runs, arms, truths = planned(), krauss_runs(), true_runs()
    return [path for path in _figures(runs, arms, truths) if path.endswith(".png")]


def systems_of(runs):
    """Systems of these runs, each once."""
    return list(dict.fromkeys(run["system"] for run in runs))


def systems_with_attention():
    """Systems that have a baseline with attention maps."""
    return systems_of(run for run in baseline_runs() if "abcd" in run["baseline"])
