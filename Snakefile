from snakemake.utils import min_version

min_version("9.27")


report: "workflow/report/workflow.rst"


include: "workflow/rules/common.smk"
include: "workflow/rules/recording.smk"
include: "workflow/rules/views_paths.smk"
include: "workflow/rules/views.smk"
include: "workflow/rules/stage1.smk"
include: "workflow/rules/chart.smk"
include: "workflow/rules/render.smk"
include: "workflow/rules/stage2.smk"
include: "workflow/rules/evaluate.smk"
include: "workflow/rules/space.smk"
include: "workflow/rules/forces.smk"
include: "workflow/rules/baselines.smk"
include: "workflow/rules/report.smk"
include: "workflow/rules/models.smk"
include: "workflow/rules/extrapolation.smk"
include: "workflow/rules/authors.smk"
include: "workflow/rules/extrapolation_paths.smk"
include: "workflow/rules/extrapolation_tables.smk"
include: "workflow/rules/deformation.smk"
include: "workflow/rules/guarantee.smk"
include: "workflow/rules/tables.smk"
include: "workflow/rules/gap_paths.smk"
include: "workflow/rules/gap_blind.smk"
include: "workflow/rules/gap.smk"


rule all:
    default_target: True
    input:
        rules.physical.output,
        rules.table.output if krauss_runs() else [],
        rules.mass.output if masses_are_ablations() else [],
        rules.truth.output if true_runs() else [],
        rules.margins.output,
        rules.force_invariants.output,
        rules.force_truth.output if pushable(true_runs()) else [],
        expand(rules.force.output, mechanism=pushed_mechanisms()),
        expand(rules.force_map.output, mechanism=pushed_mechanisms())
        if true_runs()
        else [],
        expand(rules.force_space.output, solid=planned_spatial(overrides)),
        [
            rules.sides.output.figure.format(**asdict(run))
            for run in planned_spatial(overrides).values()
        ],
        rules.guarantee.output,
        expand(rules.figure.output, system=experiment.systems),
        expand(
            [*rules.horizon.output, *rules.gallery.output],
            system=dict.fromkeys(run["system"] for run in krauss_runs()),
        ),
        expand(
            rules.attention.output,
            system=dict.fromkeys(
                run["system"] for run in baseline_runs() if "abcd" in run["baseline"]
            ),
        ),
        expand(
            rules.inertia.output,
            system=dict.fromkeys(
                run["system"] for run in mass_runs() if masses_are_ablations()
            ),
        ),
        [
            rules.extrapolation.output,
            rules.equilibrium.output,
            rules.deformation.output,
            rules.jacobian_field.output,
        ]
        if extrapolated()[0]
        else [],
        [rules.curve.output.figure.format(**run) for run in planned()],
        [rules.reconstruction.output.figure.format(**run) for run in planned()],
        [rules.latent.output.figure.format(**run) for run in planned()],
        [rules.baseline_curve.output.figure.format(**run) for run in baseline_runs()],
