rule refine:
    input:
        film=lambda wildcards: files_of(overrides, **wildcards),
        recording=rules.stage1.input.recording,
        records=rules.views.input.records,
    output:
        fine=update("results/{profile}/{recording}/{system}/fine.safetensors"),
        record="results/{profile}/{recording}/{system}/fine.json",
    log:
        "results/{profile}/logs/{recording}/{system}/fine.log",
    benchmark:
        "results/{profile}/benchmarks/{recording}/{system}/fine.tsv"
    conda:
        "../envs/lagsplat.yaml"
    threads: 1
    resources:
        mem_mb=8000,
        runtime=30,
    params:
        cfg=section("recording"),
        simulation=section("simulation"),
        release=section("release"),
        render=section("render"),
        before=before("stage1"),
        code=script_digest(SCRIPTS / "stage1/refine.py"),
    message:
        "Make the recording of {wildcards.system} ({wildcards.recording}) once more, with finer frames"
    script:
        "../scripts/stage1/refine.py"


rule sharpen:
    input:
        fine=rules.refine.output.fine,
        chart=rules.chart.output.chart,
        records=[rules.refine.output.record, rules.chart.output.record],
    output:
        decoder=update(
            "results/{profile}/{recording}/{system}/{stage1}-{ae}/decoder.safetensors"
        ),
        curve=update("results/{profile}/{recording}/{system}/{stage1}-{ae}/decoder.csv"),
        record="results/{profile}/{recording}/{system}/{stage1}-{ae}/decoder.json",
    log:
        "results/{profile}/logs/{recording}/{system}/{stage1}-{ae}/sharpen.log",
    benchmark:
        "results/{profile}/benchmarks/{recording}/{system}/{stage1}-{ae}/sharpen.tsv"
    conda:
        "../envs/lagsplat.yaml"
    threads: 8
    resources:
        mem_mb=8000,
        runtime=minutes(toy=20, quick=480, full=480),
    params:
        cfg=section("stage1"),
        render=section("render"),
        before=before("stage2"),
        code=script_digest(SCRIPTS / "stage1/sharpen.py"),
        # Not an output: it must outlive a failed or killed job. A finished one deletes it.
        checkpoint="results/{profile}/{recording}/{system}/{stage1}-{ae}/checkpoint/decoder.pt",
    message:
        "A finer decoder over the frozen chart of {wildcards.system} ({wildcards.recording})"
    script:
        "../scripts/stage1/sharpen.py"
