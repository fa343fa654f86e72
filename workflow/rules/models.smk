rule horizon:
    input:
        metrics=models_of("metrics"),
        records=models_of("record"),
    output:
        pdf="results/figures/horizon_{system}.pdf",
        png=report(
            "results/figures/horizon_{system}.png",
            caption="../report/horizon.rst",
            category="Rollouts",
            labels={"system": "{system}"},
        ),
    log:
        "results/logs/horizon_{system}.log",
    benchmark:
        "results/benchmarks/horizon_{system}.tsv"
    conda:
        "../envs/lagsplat.yaml"
    threads: 1
    resources:
        mem_mb=1500,
        runtime=10,
    params:
        title=lambda wildcards: f"Image error over time · {plan.describe_models(wildcards.system)}",
        before=lambda wildcards: [
            before(stage)(run)
            for stage, runs in zip(
                ("evaluate", "simple_table", "peer_table", "baseline_table"),
                plan.models_of(wildcards.system),
                strict=True,
            )
            for run in runs
        ],
        code=script_digest(SCRIPTS / "report/horizon.py"),
    message:
        "Draw the image error of every model of {wildcards.system} over time"
    script:
        "../scripts/report/horizon.py"


rule gallery:
    input:
        recording=lambda wildcards: rules.stage1.input.recording.format(
            **plan.runs(**wildcards)[0]
        ),
        run=lambda wildcards: [
            output.format(**plan.runs(**wildcards)[0])
            for output in (
                rules.stage1.output.autoencoder,
                rules.chart.output.chart,
                rules.stage2.output.dynamics,
            )
        ],
        models=lambda wildcards: baseline_files(
            wildcards.system, rules.baseline.output.model
        ),
        records=lambda wildcards: [
            rules.stage2.output.record.format(**plan.runs(**wildcards)[0]),
            *baseline_files(wildcards.system, rules.baseline.output.record),
        ],
    output:
        pdf="results/figures/gallery_{system}.pdf",
        png=report(
            "results/figures/gallery_{system}.png",
            caption="../report/gallery.rst",
            category="Rollouts",
            labels={"system": "{system}"},
        ),
    log:
        "results/logs/gallery_{system}.log",
    benchmark:
        "results/benchmarks/gallery_{system}.tsv"
    conda:
        "../envs/lagsplat.yaml"
    threads: 1
    resources:
        mem_mb=3000,
        runtime=10,
    params:
        cfg=lambda wildcards: section("evaluate")(plan.runs(**wildcards)[0]),
        names=lambda wildcards: plan.name_baselines(wildcards.system),
        title=lambda wildcards: plan.describe_models(wildcards.system),
        before=lambda wildcards: [
            before("evaluate")(plan.runs(**wildcards)[0]),
            *(
                before("baseline_table")(run)
                for run in plan.first_baselines(wildcards.system)
            ),
        ],
        code=script_digest(SCRIPTS / "report/gallery.py"),
    message:
        "Draw every model of {wildcards.system} from the same start"
    script:
        "../scripts/report/gallery.py"


rule attention:
    input:
        recording=lambda wildcards: rules.stage1.input.recording.format(
            **plan.runs(**wildcards)[0]
        ),
        models=lambda wildcards: baseline_files(
            wildcards.system, rules.baseline.output.model
        ),
        records=lambda wildcards: baseline_files(
            wildcards.system, rules.baseline.output.record
        ),
    output:
        pdf="results/figures/attention_{system}.pdf",
        png=report(
            "results/figures/attention_{system}.png",
            caption="../report/attention.rst",
            category="Baselines",
            labels={"system": "{system}"},
        ),
    log:
        "results/logs/attention_{system}.log",
    benchmark:
        "results/benchmarks/attention_{system}.tsv"
    conda:
        "../envs/lagsplat.yaml"
    threads: 1
    resources:
        mem_mb=2000,
        runtime=10,
    params:
        names=lambda wildcards: plan.name_baselines(wildcards.system),
        title=lambda wildcards: f"Attention maps · {plan.describe_models(wildcards.system)}",
        before=lambda wildcards: [
            before("baseline_evaluate")(run)
            for run in plan.first_baselines(wildcards.system)
        ],
        code=script_digest(SCRIPTS / "report/attention.py"),
    message:
        "Draw the attention maps of the baselines of {wildcards.system}"
    script:
        "../scripts/report/attention.py"


rule inertia:
    input:
        chart=lambda wildcards: rules.chart.output.chart.format(
            **plan.runs(**wildcards)[0]
        ),
        dynamics=lambda wildcards: [
            rules.stage2.output.dynamics.format(**run)
            for run in plan.first_masses(wildcards.system)
        ],
        records=lambda wildcards: [
            rules.stage2.output.record.format(**run)
            for run in plan.first_masses(wildcards.system)
        ],
    output:
        pdf="results/figures/inertia_{system}.pdf",
        png=report(
            "results/figures/inertia_{system}.png",
            caption="../report/inertia.rst",
            category="Dynamics",
            labels={"system": "{system}"},
        ),
    log:
        "results/logs/inertia_{system}.log",
    benchmark:
        "results/benchmarks/inertia_{system}.tsv"
    conda:
        "../envs/lagsplat.yaml"
    threads: 1
    resources:
        mem_mb=2000,
        runtime=10,
    params:
        names=lambda wildcards: [
            run["stage2"] for run in plan.first_masses(wildcards.system)
        ],
        title=lambda wildcards: f"Inertia along the held-out motion · {plan.describe_models(wildcards.system)}",
        before=lambda wildcards: [
            before("evaluate")(run) for run in plan.first_masses(wildcards.system)
        ],
        code=script_digest(SCRIPTS / "report/inertia.py"),
    message:
        "Draw the forms of the mass of {wildcards.system}"
    script:
        "../scripts/report/inertia.py"
