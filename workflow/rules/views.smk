rule views:
    input:
        recording="results/{profile}/{recording}/{system}/recording.safetensors",
        truth=branch(
            lambda wildcards: wildcards.recording == "simulated",
            then=rules.simulate.output.truth,
            otherwise=[],
        ),
        rig=rig_files,
        records=["results/{profile}/{recording}/{system}/recording.json"],
    output:
        views=update("results/{profile}/{recording}/{system}/views.safetensors"),
        record="results/{profile}/{recording}/{system}/views.json",
    log:
        "results/{profile}/logs/{recording}/{system}/views.log",
    benchmark:
        "results/{profile}/benchmarks/{recording}/{system}/views.tsv"
    conda:
        "../envs/lagsplat.yaml"
    threads: 1
    resources:
        mem_mb=4000,
        runtime=minutes(toy=10, quick=120, full=240),
    params:
        cfg=section("views"),
        source=section("recording"),
        release=section("release"),
        before=before("views"),
        code=script_digest(SCRIPTS / "recording/views.py"),
        # Not an output: lifted frames took long and outlive a failed or killed job.
        cache="results/{profile}/{recording}/{system}/sharp",
    message:
        "Views of {wildcards.system} ({wildcards.recording}) from other sides"
    script:
        "../scripts/recording/views.py"
