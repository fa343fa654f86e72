rule stage1:
    input:
        recording="results/{profile}/{recording}/{system}/recording.safetensors",
        views=branch(sided, then=rules.views.output.views, otherwise=[]),
        records=lambda wildcards: [
            path.format(**wildcards)
            for path in (
                rules.views.input.records[0],
                *([rules.views.output.record] if sided(wildcards) else []),
            )
        ],
    output:
        autoencoder=update(
            "results/{profile}/{recording}/{system}/{stage1}-{ae}/autoencoder.safetensors"
        ),
        curve=update("results/{profile}/{recording}/{system}/{stage1}-{ae}/curve.csv"),
        record="results/{profile}/{recording}/{system}/{stage1}-{ae}/autoencoder.json",
    log:
        "results/{profile}/logs/{recording}/{system}/{stage1}-{ae}/stage1.log",
    benchmark:
        "results/{profile}/benchmarks/{recording}/{system}/{stage1}-{ae}/stage1.tsv"
    priority: 2  # before the models that it is compared with
    conda:
        "../envs/lagsplat.yaml"
    threads: lambda wildcards: plan.count_stage1_threads(wildcards, workflow.cores)
    resources:
        mem_mb=4000,
        runtime=minutes(toy=10, quick=120, full=480),
    params:
        cfg=section("stage1"),
        views=section("views"),
        before=before("stage1"),
        code=script_digest(SCRIPTS / "stage1/stage1.py"),
        # Not an output: it must outlive a failed or killed job. A finished one deletes it.
        checkpoint="results/{profile}/{recording}/{system}/{stage1}-{ae}/checkpoint/state.pt",
    message:
        "Stage 1: encoder and Gaussians of {wildcards.system} ({wildcards.recording})"
    script:
        "../scripts/stage1/stage1.py"


rule reconstruction:
    input:
        recording=rules.stage1.input.recording,
        autoencoder=rules.stage1.output.autoencoder,
        records=[rules.stage1.output.record],
    output:
        pdf="results/{profile}/{recording}/{system}/{stage1}-{ae}/reconstruction.pdf",
        png=report(
            "results/{profile}/{recording}/{system}/{stage1}-{ae}/reconstruction.png",
            caption="../report/reconstruction.rst",
            category="Stage 1",
            labels={
                "system": "{system}",
                "recording": "{recording}",
                "profile": "{profile}",
            },
        ),
    log:
        "results/{profile}/logs/{recording}/{system}/{stage1}-{ae}/reconstruction.log",
    benchmark:
        "results/{profile}/benchmarks/{recording}/{system}/{stage1}-{ae}/reconstruction.tsv"
    conda:
        "../envs/lagsplat.yaml"
    threads: 1
    resources:
        mem_mb=2000,
        runtime=10,
    params:
        title=section("system.title"),
        before=before("chart"),
        code=script_digest(SCRIPTS / "stage1/reconstruction.py"),
    message:
        "Draw recorded and reconstructed frames of {wildcards.system} ({wildcards.recording})"
    script:
        "../scripts/stage1/reconstruction.py"


rule curve:
    input:
        curve=rules.stage1.output.curve,
        records=[rules.stage1.output.record],
    output:
        pdf="results/{profile}/{recording}/{system}/{stage1}-{ae}/curve.pdf",
        png=report(
            "results/{profile}/{recording}/{system}/{stage1}-{ae}/curve.png",
            caption="../report/curve.rst",
            category="Stage 1",
            labels={
                "system": "{system}",
                "recording": "{recording}",
                "profile": "{profile}",
            },
        ),
    log:
        "results/{profile}/logs/{recording}/{system}/{stage1}-{ae}/curve.log",
    benchmark:
        "results/{profile}/benchmarks/{recording}/{system}/{stage1}-{ae}/curve.tsv"
    conda:
        "../envs/lagsplat.yaml"
    threads: 1
    resources:
        mem_mb=2000,
        runtime=10,
    params:
        title=section("system.title"),
        before=before("chart"),
        code=script_digest(SCRIPTS / "stage1/curve.py"),
    message:
        "Draw the training curve of {wildcards.system} ({wildcards.recording})"
    script:
        "../scripts/stage1/curve.py"
