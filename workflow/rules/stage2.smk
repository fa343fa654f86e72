rule stage2:
    input:
        autoencoder=rules.stage1.output.autoencoder,
        chart=rules.chart.output.chart,
        records=[rules.chart.output.record],
    output:
        dynamics=update(
            "results/{profile}/{recording}/{system}/{stage1}-{ae}/{stage2}-{seed}/dynamics.safetensors"
        ),
        curve=update(
            "results/{profile}/{recording}/{system}/{stage1}-{ae}/{stage2}-{seed}/curve.csv"
        ),
        record="results/{profile}/{recording}/{system}/{stage1}-{ae}/{stage2}-{seed}/dynamics.json",
    log:
        "results/{profile}/logs/{recording}/{system}/{stage1}-{ae}/{stage2}-{seed}/stage2.log",
    benchmark:
        "results/{profile}/benchmarks/{recording}/{system}/{stage1}-{ae}/{stage2}-{seed}/stage2.tsv"
    priority: 2  # before the models that it is compared with
    conda:
        "../envs/lagsplat.yaml"
    threads: 1
    resources:
        mem_mb=4000,
        runtime=minutes(toy=10, quick=90, full=180),
    params:
        cfg=section("stage2"),
        before=before("stage2"),
        code=script_digest(SCRIPTS / "stage2/stage2.py"),
        # Not an output: it must outlive a failed or killed job. A finished one deletes it.
        checkpoint="results/{profile}/{recording}/{system}/{stage1}-{ae}/{stage2}-{seed}/checkpoint/state.pt",
    message:
        "Stage 2: {wildcards.stage2} dynamics of {wildcards.system} ({wildcards.recording}), seed {wildcards.seed}"
    script:
        "../scripts/stage2/stage2.py"
