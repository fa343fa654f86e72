rule rollout:
    input:
        recording=rules.stage1.input.recording,
        autoencoder=rules.stage1.output.autoencoder,
        chart=rules.chart.output.chart,
        dynamics=rules.stage2.output.dynamics,
        decoder=branch(refined, then=rules.sharpen.output.decoder, otherwise=[]),
        fine=branch(refined, then=rules.refine.output.fine, otherwise=[]),
        records=[rules.chart.output.record, rules.stage2.output.record],
    output:
        pdf="results/{profile}/{recording}/{system}/{stage1}-{ae}/{stage2}-{seed}/rollout.pdf",
        png="results/{profile}/{recording}/{system}/{stage1}-{ae}/{stage2}-{seed}/rollout.png",
    log:
        "results/{profile}/logs/{recording}/{system}/{stage1}-{ae}/{stage2}-{seed}/rollout.log",
    benchmark:
        "results/{profile}/benchmarks/{recording}/{system}/{stage1}-{ae}/{stage2}-{seed}/rollout.tsv"
    conda:
        "../envs/lagsplat.yaml"
    threads: 1
    resources:
        mem_mb=3000,
        runtime=10,
    params:
        cfg=section("evaluate"),
        title=section("system.title"),
        before=before("evaluate"),
        code=script_digest(SCRIPTS / "report/rollout.py"),
    message:
        "Draw a long rollout of {wildcards.system} ({wildcards.recording}, {wildcards.stage2})"
    script:
        "../scripts/report/rollout.py"


rule figure:
    input:
        pdf=lambda wildcards: rules.rollout.output.pdf.format(
            **plan.runs(**wildcards)[0]
        ),
        png=lambda wildcards: rules.rollout.output.png.format(
            **plan.runs(**wildcards)[0]
        ),
    output:
        pdf="results/figures/rollout_{system}.pdf",
        png=report(
            "results/figures/rollout_{system}.png",
            caption="../report/rollout.rst",
            category="Rollouts",
            labels={"system": "{system}"},
        ),
    log:
        "results/logs/rollout_{system}.log",
    benchmark:
        "results/benchmarks/rollout_{system}.tsv"
    conda:
        "../envs/lagsplat.yaml"
    threads: 1
    resources:
        mem_mb=1500,
        runtime=10,
    params:
        before=lambda wildcards: before("evaluate")(plan.runs(**wildcards)[0]),
        code=script_digest(SCRIPTS / "report/figure.py"),
    message:
        "Show the rollout of {wildcards.system}"
    script:
        "../scripts/report/figure.py"


rule contact_sheet:
    input:
        pictures=lambda wildcards: drawn(),
    output:
        pdf="results/figures/contact_sheet.pdf",
        png=report(
            "results/figures/contact_sheet.png",
            caption="../report/contact_sheet.rst",
            category="All figures",
            labels={"figure": "all, small"},
        ),
    log:
        "results/logs/contact_sheet.log",
    benchmark:
        "results/benchmarks/contact_sheet.tsv"
    conda:
        "../envs/lagsplat.yaml"
    threads: 1
    resources:
        mem_mb=3000,
        runtime=10,
    params:
        title=lambda wildcards, input: f"All {len(input.pictures)} figures · profile {experiment.choices['profile']}",
        code=script_digest(SCRIPTS / "report/contact_sheet.py"),
    message:
        "Show every figure on one sheet"
    script:
        "../scripts/report/contact_sheet.py"
