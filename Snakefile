from snakemake.utils import min_version

min_version("9.10")


report: "workflow/report/workflow.rst"


include: "workflow/rules/common.smk"
include: "workflow/rules/recording.smk"
include: "workflow/rules/views_paths.smk"
include: "workflow/rules/views.smk"
include: "workflow/rules/stage1.smk"
include: "workflow/rules/chart.smk"
include: "workflow/rules/matter.smk"
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
include: "workflow/rules/calibration.smk"
include: "workflow/rules/gap.smk"


rule all:
    default_target: True
    input:
        lambda wildcards: final_outputs(),
