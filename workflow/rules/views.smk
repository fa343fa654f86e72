def sided(wildcards):
    """Whether this run is taught by pictures from other sides."""
    return section("views")(wildcards) is not None


def rig_files(wildcards):
    """The files of the user's rig."""
    views = section("views")(wildcards)
    return files_of_rig(views["rig"]) if views and views["rig"] else []


def spatial(mechanism):
    """Wildcards of the run behind a figure in space."""
    return asdict(planned_spatial(overrides)[mechanism])


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
    params:
        cfg=section("views"),
        source=section("recording"),
        release=section("release"),
        before=before("views"),
        code=script_digest(SCRIPTS / "views.py"),
        # Not an output: lifted frames took long and outlive a failed or killed job.
        cache="results/{profile}/{recording}/{system}/sharp",
    message:
        "Views of {wildcards.system} ({wildcards.recording}) from other sides"
    script:
        "../scripts/views.py"
