from dataclasses import asdict

from lagsplat.project import use_project

PIPELINE = use_project(workflow.basedir)  # before the settings in it are looked for

from lagsplat.config.compose import ConfigError
from lagsplat.config.schema import options
from lagsplat.planning.experiment_plan import (
    SYSTEMS_OF_FIGURES,
    ExperimentPlan,
    list_choices,
    list_image_models,
    list_systems,
)
from lagsplat.planning.plan import (
    SUFFIX,
    TRIVIAL,
    files_of,
    files_of_rig,
    lineage,
    planned_spatial,
    read_overrides,
    script_digest,
    weights_of,
)
from lagsplat.processes import announce_driver
from lagsplat.provenance import let_waiting_threads_sleep

let_waiting_threads_sleep()  # the jobs inherit it
announce_driver()

# snakemake --config hydra="profile=full stage2.steps=9000" hydra_krauss_2seg="stage1=upstream"
try:
    overrides = read_overrides(config)
    plan = ExperimentPlan(overrides)
    experiment, section = plan.experiment, plan.section
    if workflow.is_main_process:  # all is checked once, before the first job
        plan.runs()
        plan.baseline_runs()
        plan.extrapolated()
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
    planar_decoder="conditioned|deformed",
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


def before(stage):
    """Digest of the settings and code that made the inputs of a job."""
    return lambda wildcards: lineage(
        overrides, SCRIPTS, stage, **list_choices(wildcards)
    )


def minutes(toy, quick, full):
    """Time limit of a training run, by profile; every further try has as much again, up to a day."""
    limits = {"toy": toy, "quick": quick, "full": full}
    return lambda wildcards, attempt: min(attempt * limits[wildcards.profile], 24 * 60)


def refined(wildcards):
    """Whether figures of this run are drawn by a finer decoder of their own."""
    return section("render")(wildcards) is not None


def simple_predictors(chosen, output):
    """An input function: one output of the simple predictors for every autoencoder of the chosen runs."""
    return lambda wildcards: [
        rules.simple_predictors.output[output].format(**model)
        for model in list_image_models(chosen())
    ]


def baseline_files(system, output):
    """One output for each of them."""
    return [output.format(**run) for run in plan.first_baselines(system)]


def models_of(output):
    """An input function: one output for every seed of all that forecasts a system."""

    def gather(wildcards):
        makers = (
            rules.evaluate,
            rules.simple_predictors,
            rules.ode_evaluate,
            rules.baseline_evaluate,
        )
        models = zip(makers, plan.models_of(wildcards.system), strict=True)
        return [
            maker.output[output].format(**run) for maker, runs in models for run in runs
        ]

    return gather


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


def gathered(chosen, output):
    """An input function: one output of rule evaluate for all the runs that ``chosen`` gives."""

    def files(wildcards):
        if not chosen():
            kinds = {
                plan.krauss_runs: "a pneumatic arm (system.film_kind=krauss)",
                plan.mass_runs: "a pneumatic arm (system.film_kind=krauss)",
                plan.true_runs: "simulated",
            }
            raise WorkflowError(
                f"this table would be empty: no system of systems={experiment.systems} is "
                f"{kinds[chosen]}; choose others with systems=[...], or make results/tables/physical.tex"
            )
        return [rules.evaluate.output[output].format(**run) for run in chosen()]

    return files


def final_outputs():
    """What `snakemake` makes without a target: every table and figure that the experiment has runs for."""
    runs, arms, truths = plan.runs(), plan.krauss_runs(), plan.true_runs()
    tables = [*rules.physical.output, *rules.margins.output, *rules.guarantee.output]
    tables += rules.force_invariants.output
    tables += rules.table.output if arms else []
    tables += rules.mass.output if plan.masses_are_ablations() else []
    tables += rules.truth.output if truths else []
    tables += rules.force_truth.output if plan.pushable(truths) else []
    return [*tables, *_figures(runs, arms, truths)]


def _figures(runs, arms, truths):
    mechanisms, solids = plan.pushed_mechanisms(), planned_spatial(overrides)
    figures = [
        *expand(rules.force.output, mechanism=mechanisms),
        *expand(rules.force_map.output, mechanism=mechanisms if truths else []),
        *expand(rules.force_space.output, solid=solids),
        *expand(rules.figure.output, system=experiment.systems),
        *expand(
            [*rules.horizon.output, *rules.gallery.output], system=list_systems(arms)
        ),
        *expand(rules.attention.output, system=plan.systems_with_attention()),
    ]
    if plan.masses_are_ablations():
        figures += expand(rules.inertia.output, system=list_systems(plan.mass_runs()))
    if plan.extrapolated()[0]:
        for name in ("extrapolation", "equilibrium", "deformation", "jacobian_field"):
            figures += getattr(rules, name).output
    for name in ("curve", "reconstruction", "latent"):
        figures += filled(getattr(rules, name), runs)
    figures += filled(rules.baseline_curve, plan.baseline_runs())
    return figures + filled(rules.sides, [asdict(run) for run in solids.values()])


def filled(rule, runs):
    """All outputs of a rule for each of these runs."""
    return [output.format(**run) for run in runs for output in rule.output]


def drawn():
    """The pictures among them."""
    runs, arms, truths = plan.runs(), plan.krauss_runs(), plan.true_runs()
    return [path for path in _figures(runs, arms, truths) if path.endswith(".png")]
