rule plant:
    output:
        recording=update(
            "results/{profile}/simulated/{system}/planted/{effect}/recording.safetensors"
        ),
        record="results/{profile}/simulated/{system}/planted/{effect}/recording.json",
    log:
        "results/{profile}/logs/simulated/{system}/planted/{effect}.log",
    benchmark:
        "results/{profile}/benchmarks/simulated/{system}/planted/{effect}.tsv"
    conda:
        "../envs/lagsplat.yaml"
    threads: 1
    resources:
        mem_mb=2000,
        runtime=20,
    params:
        simulation=section("simulation", recording="simulated"),
        n_frames=section("planted.n_frames", recording="simulated"),
        drive=section("planted.seed", recording="simulated"),
        planted=lambda wildcards: section("planted")(wildcards)["effects"][
            wildcards.effect
        ],
        code=script_digest(SCRIPTS / "diagnosis/plant.py"),
    message:
        "Simulate {wildcards.system} once more, with {wildcards.effect} planted"
    script:
        "../scripts/diagnosis/plant.py"


rule diagnose:
    input:
        recording=rules.stage1.input.recording,
        autoencoder=rules.stage1.output.autoencoder,
        chart=rules.chart.output.chart,
        dynamics=rules.stage2.output.dynamics,
        real=branch(
            lambda wildcards: wildcards.real == "held_out",
            then=[],
            otherwise="results/{profile}/{recording}/{system}/planted/{real}/recording.safetensors",
        ),
        records=[rules.chart.output.record, rules.stage2.output.record],
    output:
        diagnosis=update(
            "results/{profile}/{recording}/{system}/{stage1}-{ae}/{stage2}-{seed}/gap/{real}/diagnosis.json"
        ),
        page=report(
            "results/{profile}/{recording}/{system}/{stage1}-{ae}/{stage2}-{seed}/gap/{real}/report.html",
            caption="../report/diagnosis.rst",
            category="Sim-to-real gap",
            labels={
                "system": "{system}",
                "recording": "{recording}",
                "against": "{real}",
            },
        ),
        rollouts=update(
            "results/{profile}/{recording}/{system}/{stage1}-{ae}/{stage2}-{seed}/gap/{real}/rollouts.csv"
        ),
        augmented=update(
            "results/{profile}/{recording}/{system}/{stage1}-{ae}/{stage2}-{seed}/gap/{real}/augmented.safetensors"
        ),
        record="results/{profile}/{recording}/{system}/{stage1}-{ae}/{stage2}-{seed}/gap/{real}/diagnose.json",
    log:
        "results/{profile}/logs/{recording}/{system}/{stage1}-{ae}/{stage2}-{seed}/gap-{real}.log",
    benchmark:
        "results/{profile}/benchmarks/{recording}/{system}/{stage1}-{ae}/{stage2}-{seed}/gap-{real}.tsv"
    conda:
        "../envs/lagsplat.yaml"
    threads: 1
    resources:
        mem_mb=3000,
        runtime=60,
    params:
        cfg=section("diagnose"),
        before=before("evaluate"),
        code=script_digest(SCRIPTS / "diagnosis/diagnose.py"),
    message:
        "Diagnose {wildcards.system} ({wildcards.recording}) against {wildcards.real}"
    script:
        "../scripts/diagnosis/diagnose.py"


rule gap:
    input:
        diagnoses=lambda wildcards: [
            rules.diagnose.output.diagnosis.format(**one) for one in plan.diagnosed()
        ],
        records=lambda wildcards: [
            rules.diagnose.output.record.format(**one) for one in plan.diagnosed()
        ],
    output:
        tex="results/tables/gap.tex",
        csv="results/tables/gap.csv",
        html=report(
            "results/tables/gap.html",
            caption="../report/gap.rst",
            category="Tables",
            labels={"table": "sim-to-real gap"},
        ),
    log:
        "results/logs/gap.log",
    benchmark:
        "results/benchmarks/gap.tsv"
    conda:
        "../envs/lagsplat.yaml"
    threads: 1
    resources:
        mem_mb=1500,
        runtime=10,
    params:
        runs=lambda wildcards: plan.diagnosed(),
        titles=lambda wildcards: plan.titles(plan.diagnosed()),
        before=lambda wildcards: [before("table")(one) for one in plan.diagnosed()],
        code=script_digest(SCRIPTS / "diagnosis/gap.py"),
    message:
        "Gather the diagnoses of every system in one table"
    script:
        "../scripts/diagnosis/gap.py"
