rule evaluate:
    input:
        recording=rules.stage1.input.recording,
        truth=branch(
            lambda wildcards: wildcards.recording == "simulated",
            then=rules.simulate.output.truth,
            otherwise=[],
        ),
        autoencoder=rules.stage1.output.autoencoder,
        chart=rules.chart.output.chart,
        dynamics=rules.stage2.output.dynamics,
        records=[
            rules.stage1.output.record,
            rules.chart.output.record,
            rules.stage2.output.record,
        ],
    output:
        metrics=update(
            "results/{profile}/{recording}/{system}/{stage1}-{ae}/{stage2}-{seed}/metrics.json"
        ),
        record="results/{profile}/{recording}/{system}/{stage1}-{ae}/{stage2}-{seed}/evaluate.json",
    log:
        "results/{profile}/logs/{recording}/{system}/{stage1}-{ae}/{stage2}-{seed}/evaluate.log",
    benchmark:
        "results/{profile}/benchmarks/{recording}/{system}/{stage1}-{ae}/{stage2}-{seed}/evaluate.tsv"
    priority: 2  # before the models that it is compared with
    conda:
        "../envs/lagsplat.yaml"
    threads: 1
    resources:
        mem_mb=3000,
        runtime=20,
    params:
        cfg=section("evaluate"),
        before=before("evaluate"),
        code=script_digest(SCRIPTS / "stage2/evaluate.py"),
    message:
        "Evaluate {wildcards.stage2} dynamics of {wildcards.system} ({wildcards.recording}), seed {wildcards.seed}"
    script:
        "../scripts/stage2/evaluate.py"


rule simple_predictors:
    input:
        recording=rules.stage1.input.recording,
        autoencoder=rules.stage1.output.autoencoder,
        chart=rules.chart.output.chart,
        records=[rules.chart.output.record],
    output:
        metrics=update(
            "results/{profile}/{recording}/{system}/{stage1}-{ae}/simple/metrics.json"
        ),
        record="results/{profile}/{recording}/{system}/{stage1}-{ae}/simple/evaluate.json",
    log:
        "results/{profile}/logs/{recording}/{system}/{stage1}-{ae}/simple/evaluate.log",
    benchmark:
        "results/{profile}/benchmarks/{recording}/{system}/{stage1}-{ae}/simple/evaluate.tsv"
    conda:
        "../envs/lagsplat.yaml"
    threads: 1
    resources:
        mem_mb=3000,
        runtime=20,
    params:
        cfg=section("evaluate"),
        before=before("simple"),
        code=script_digest(SCRIPTS / "stage2/simple_predictors.py"),
    message:
        "Score simple predictors of {wildcards.system} ({wildcards.recording}), which any model must beat"
    script:
        "../scripts/stage2/simple_predictors.py"
