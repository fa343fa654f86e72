rule sides:
    input:
        recording=rules.stage1.input.recording,
        views=rules.views.output.views,
        autoencoder=rules.stage1.output.autoencoder,
        records=[rules.stage1.output.record],
    output:
        metrics="results/{profile}/{recording}/{system}/{stage1}-{ae}/sides.json",
        pdf="results/{profile}/{recording}/{system}/{stage1}-{ae}/sides.pdf",
        png=report(
            "results/{profile}/{recording}/{system}/{stage1}-{ae}/sides.png",
            caption="../report/sides.rst",
            category="Stage 1",
            labels={
                "system": "{system}",
                "recording": "{recording}",
                "profile": "{profile}",
            },
        ),
    log:
        "results/{profile}/logs/{recording}/{system}/{stage1}-{ae}/sides.log",
    benchmark:
        "results/{profile}/benchmarks/{recording}/{system}/{stage1}-{ae}/sides.tsv"
    conda:
        "../envs/lagsplat.yaml"
    threads: 1
    resources:
        mem_mb=3000,
        runtime=10,
    params:
        title=section("system.title"),
        before=before("chart"),
        code=script_digest(SCRIPTS / "stage1/sides.py"),
    message:
        "Score and draw {wildcards.system} ({wildcards.recording}) from held-out sides"
    script:
        "../scripts/stage1/sides.py"


rule force_space:
    input:
        run=lambda wildcards: [
            output.format(**spatial(wildcards.solid))
            for output in (
                rules.stage1.output.autoencoder,
                rules.chart.output.chart,
                rules.stage2.output.dynamics,
                rules.matter.output.matter,
            )
        ],
        records=lambda wildcards: [
            rules.stage2.output.record.format(**spatial(wildcards.solid)),
            rules.matter.output.record.format(**spatial(wildcards.solid)),
        ],
    output:
        pdf="results/figures/force_{solid}_3d.pdf",
        png=report(
            "results/figures/force_{solid}_3d.png",
            caption="../report/force_space.rst",
            category="Forces",
            labels={"system": "{solid}, in space"},
        ),
        metrics="results/figures/force_{solid}_3d.json",
    log:
        "results/logs/force_{solid}_3d.log",
    benchmark:
        "results/benchmarks/force_{solid}_3d.tsv"
    conda:
        "../envs/lagsplat.yaml"
    threads: 1
    resources:
        mem_mb=2000,
        runtime=10,
    params:
        cfg=lambda wildcards: section("forces")(spatial(wildcards.solid)),
        title=lambda wildcards: "Forces in space · {recording} recording of {system} · profile {profile}".format(
            **spatial(wildcards.solid)
        ),
        before=lambda wildcards: before_push(spatial(wildcards.solid)),
        code=script_digest(SCRIPTS / "forces/force_space.py"),
    message:
        "Push {wildcards.solid} in space"
    script:
        "../scripts/forces/force_space.py"
