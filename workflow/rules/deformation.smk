rule planar_decoder:
    input:
        recording=rules.stage1.input.recording,
        chart=rules.chart.output.chart,
        records=[rules.chart.output.record],
    output:
        model=update(
            "results/{profile}/{recording}/{system}/{stage1}-{ae}/planar_decoders/{planar_decoder}.safetensors"
        ),
        record="results/{profile}/{recording}/{system}/{stage1}-{ae}/planar_decoders/{planar_decoder}.json",
    log:
        "results/{profile}/logs/{recording}/{system}/{stage1}-{ae}/planar_decoders/{planar_decoder}.log",
    benchmark:
        "results/{profile}/benchmarks/{recording}/{system}/{stage1}-{ae}/planar_decoders/{planar_decoder}.tsv"
    conda:
        "../envs/lagsplat.yaml"
    threads: 1
    resources:
        mem_mb=3000,
        runtime=minutes(toy=10, quick=30, full=120),
    params:
        cfg=section("deformation"),
        stage1=section("stage1"),
        before=before("planar"),
        code=script_digest(SCRIPTS / "extrapolation/planar_decoder.py"),
    message:
        "The {wildcards.planar_decoder} decoder of {wildcards.system} ({wildcards.recording})"
    script:
        "../scripts/extrapolation/planar_decoder.py"


rule velocity_field:
    input:
        recording=rules.stage1.input.recording,
        chart=rules.chart.output.chart,
        models=[
            "results/{profile}/{recording}/{system}/{stage1}-{ae}/planar_decoders/conditioned.safetensors",
            "results/{profile}/{recording}/{system}/{stage1}-{ae}/planar_decoders/deformed.safetensors",
        ],
        records=[
            rules.chart.output.record,
            "results/{profile}/{recording}/{system}/{stage1}-{ae}/planar_decoders/conditioned.json",
            "results/{profile}/{recording}/{system}/{stage1}-{ae}/planar_decoders/deformed.json",
        ],
    output:
        maps=update(
            "results/{profile}/{recording}/{system}/{stage1}-{ae}/velocity_field.safetensors"
        ),
        record="results/{profile}/{recording}/{system}/{stage1}-{ae}/velocity_field.json",
    log:
        "results/{profile}/logs/{recording}/{system}/{stage1}-{ae}/velocity_field.log",
    benchmark:
        "results/{profile}/benchmarks/{recording}/{system}/{stage1}-{ae}/velocity_field.tsv"
    conda:
        "../envs/lagsplat.yaml"
    threads: 1
    resources:
        mem_mb=2000,
        runtime=20,
    params:
        cfg=section("deformation"),
        window=section("stage1.loss.ssim_window"),
        before=before("planar_read"),
        code=script_digest(SCRIPTS / "extrapolation/velocity_field.py"),
    message:
        "Read the velocities of both decoders of {wildcards.system} ({wildcards.recording})"
    script:
        "../scripts/extrapolation/velocity_field.py"


rule deformation:
    input:
        maps=lambda wildcards: some(
            [rules.velocity_field.output.maps.format(**run) for run in planar_runs()]
        ),
        records=[
            rules.velocity_field.output.record.format(**run) for run in planar_runs()
        ],
    output:
        tex="results/tables/deformation.tex",
        csv="results/tables/deformation.csv",
        html=report(
            "results/tables/deformation.html",
            caption="../report/deformation.rst",
            category="Tables",
            labels={"table": "two decoders"},
        ),
    log:
        "results/logs/deformation.log",
    benchmark:
        "results/benchmarks/deformation.tsv"
    conda:
        "../envs/lagsplat.yaml"
    threads: 1
    resources:
        mem_mb=1500,
        runtime=10,
    params:
        runs=lambda wildcards: planar_runs(),
        titles=lambda wildcards: plan.titles(planar_runs()),
        before=lambda wildcards: [before("planar_table")(run) for run in planar_runs()],
        code=script_digest(SCRIPTS / "extrapolation/deformation.py"),
    message:
        "Compare two decoders at an equal number of primitives"
    script:
        "../scripts/extrapolation/deformation.py"


rule jacobian_field:
    input:
        maps=lambda wildcards: some(
            [
                rules.velocity_field.output.maps.format(**run)
                for run in planar_runs()[:1]
            ]
        ),
        records=[
            rules.velocity_field.output.record.format(**run)
            for run in planar_runs()[:1]
        ],
    output:
        pdf="results/figures/jacobian_field.pdf",
        png=report(
            "results/figures/jacobian_field.png",
            caption="../report/jacobian_field.rst",
            category="Rollouts",
            labels={"figure": "velocities of the primitives"},
        ),
    log:
        "results/logs/jacobian_field.log",
    benchmark:
        "results/benchmarks/jacobian_field.tsv"
    conda:
        "../envs/lagsplat.yaml"
    threads: 1
    resources:
        mem_mb=1500,
        runtime=10,
    params:
        title=lambda wildcards: "The same motion read off two decoders · {title} · {recording} recording · profile {profile}".format(
            title=plan.titles(planar_runs())[planar_runs()[0]["system"]],
            **planar_runs()[0],
        ),
        before=lambda wildcards: [
            before("planar_table")(run) for run in planar_runs()[:1]
        ],
        code=script_digest(SCRIPTS / "extrapolation/jacobian_field.py"),
    message:
        "Draw the velocities of the primitives of two decoders"
    script:
        "../scripts/extrapolation/jacobian_field.py"
