rule matter:
    input:
        recording=rules.stage1.input.recording,
        views=branch(sided, then=rules.views.output.views, otherwise=[]),
        autoencoder=rules.stage1.output.autoencoder,
        chart=rules.chart.output.chart,
        records=[rules.chart.output.record],
    output:
        matter=update(
            "results/{profile}/{recording}/{system}/{stage1}-{ae}/matter.safetensors"
        ),
        record="results/{profile}/{recording}/{system}/{stage1}-{ae}/matter.json",
    log:
        "results/{profile}/logs/{recording}/{system}/{stage1}-{ae}/matter.log",
    benchmark:
        "results/{profile}/benchmarks/{recording}/{system}/{stage1}-{ae}/matter.tsv"
    conda:
        "../envs/lagsplat.yaml"
    threads: 1
    resources:
        mem_mb=lambda wildcards: 3000 if sided(wildcards) else 2000,
        runtime=30,
    params:
        cfg=section("matter"),
        before=before("matter"),
        code=script_digest(SCRIPTS / "matter/matter.py"),
    message:
        "Matter: find the bodies of {wildcards.system} ({wildcards.recording}) and how they move"
    script:
        "../scripts/matter/matter.py"


rule material_paths:
    input:
        recording=rules.matter.input.recording,
        truth=branch(
            lambda wildcards: wildcards.recording == "simulated",
            then=rules.simulate.output.truth,
            otherwise=[],
        ),
        autoencoder=rules.matter.input.autoencoder,
        chart=rules.matter.input.chart,
        matter=rules.matter.output.matter,
        records=[rules.matter.output.record],
    output:
        pdf="results/{profile}/{recording}/{system}/{stage1}-{ae}/material_paths.pdf",
        png=report(
            "results/{profile}/{recording}/{system}/{stage1}-{ae}/material_paths.png",
            caption="../report/material_paths.rst",
            category="Matter",
            labels={
                "system": "{system}",
                "recording": "{recording}",
                "profile": "{profile}",
            },
        ),
        metrics=update(
            "results/{profile}/{recording}/{system}/{stage1}-{ae}/material_paths.json"
        ),
    log:
        "results/{profile}/logs/{recording}/{system}/{stage1}-{ae}/material_paths.log",
    benchmark:
        "results/{profile}/benchmarks/{recording}/{system}/{stage1}-{ae}/material_paths.tsv"
    conda:
        "../envs/lagsplat.yaml"
    threads: 1
    resources:
        mem_mb=2000,
        runtime=10,
    params:
        points=section("forces.points"),
        simulation=section("simulation"),
        release=section("release"),
        title=section("system.title"),
        before=before("matter_paths"),
        code=script_digest(SCRIPTS / "matter/material_paths.py"),
    message:
        "Follow material points of {wildcards.system} ({wildcards.recording})"
    script:
        "../scripts/matter/material_paths.py"
