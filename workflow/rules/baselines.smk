rule baseline:
    input:
        recording=rules.stage1.input.recording,
        weights=lambda wildcards: weights_of(overrides, **list_choices(wildcards)) or [],
        records=rules.views.input.records,
    output:
        model=update(
            "results/{profile}/{recording}/{system}/baselines/{baseline}-{seed}/model.safetensors"
        ),
        record="results/{profile}/{recording}/{system}/baselines/{baseline}-{seed}/model.json",
    log:
        "results/{profile}/logs/{recording}/{system}/baselines/{baseline}-{seed}/baseline.log",
    benchmark:
        "results/{profile}/benchmarks/{recording}/{system}/baselines/{baseline}-{seed}/baseline.tsv"
    # The slowest first, so that none of them is left to one core at the end.
    priority: lambda wildcards: int("abcd" in wildcards.baseline)
    conda:
        "../envs/lagsplat.yaml"
    threads: 1
    resources:
        mem_mb=3000,
        runtime=minutes(toy=10, quick=30, full=1440),
    params:
        cfg=section("baseline"),
        before=before("baseline"),
        code=script_digest(SCRIPTS / "baselines/baseline.py"),
        # Not an output: it must outlive a failed or killed job. A finished one deletes it.
        checkpoint="results/{profile}/{recording}/{system}/baselines/{baseline}-{seed}/checkpoint/state.pt",
    message:
        "Baseline {wildcards.baseline} of {wildcards.system} ({wildcards.recording}), seed {wildcards.seed}"
    script:
        "../scripts/baselines/baseline.py"


rule baseline_evaluate:
    input:
        recording=rules.stage1.input.recording,
        model=rules.baseline.output.model,
        records=[rules.baseline.output.record],
    output:
        metrics=update(
            "results/{profile}/{recording}/{system}/baselines/{baseline}-{seed}/metrics.json"
        ),
        record="results/{profile}/{recording}/{system}/baselines/{baseline}-{seed}/evaluate.json",
    log:
        "results/{profile}/logs/{recording}/{system}/baselines/{baseline}-{seed}/evaluate.log",
    benchmark:
        "results/{profile}/benchmarks/{recording}/{system}/baselines/{baseline}-{seed}/evaluate.tsv"
    conda:
        "../envs/lagsplat.yaml"
    threads: 1
    resources:
        mem_mb=3000,
        runtime=30,
    params:
        cfg=section("evaluate"),
        before=before("baseline_evaluate"),
        code=script_digest(SCRIPTS / "baselines/baseline_evaluate.py"),
    message:
        "Score baseline {wildcards.baseline} of {wildcards.system} ({wildcards.recording}), seed {wildcards.seed}"
    script:
        "../scripts/baselines/baseline_evaluate.py"


rule baseline_curve:
    input:
        model=rules.baseline.output.model,
        records=[rules.baseline.output.record],
    output:
        pdf="results/{profile}/{recording}/{system}/baselines/{baseline}-{seed}/curve.pdf",
        png=report(
            "results/{profile}/{recording}/{system}/baselines/{baseline}-{seed}/curve.png",
            caption="../report/baseline_curve.rst",
            category="Baselines",
            labels={
                "system": "{system}",
                "recording": "{recording}",
                "baseline": "{baseline}",
            },
        ),
    log:
        "results/{profile}/logs/{recording}/{system}/baselines/{baseline}-{seed}/curve.log",
    benchmark:
        "results/{profile}/benchmarks/{recording}/{system}/baselines/{baseline}-{seed}/curve.tsv"
    conda:
        "../envs/lagsplat.yaml"
    threads: 1
    resources:
        mem_mb=2000,
        runtime=10,
    params:
        title=section("system.title"),
        before=before("baseline_evaluate"),
        code=script_digest(SCRIPTS / "baselines/baseline_curve.py"),
    message:
        "Draw the training curve of baseline {wildcards.baseline} of {wildcards.system} ({wildcards.recording})"
    script:
        "../scripts/baselines/baseline_curve.py"
