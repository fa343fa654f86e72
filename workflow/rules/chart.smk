rule chart:
    input:
        recording=rules.stage1.input.recording,
        autoencoder=rules.stage1.output.autoencoder,
        records=[rules.stage1.output.record],
    output:
        chart=update(
            "results/{profile}/{recording}/{system}/{stage1}-{ae}/chart.safetensors"
        ),
        record="results/{profile}/{recording}/{system}/{stage1}-{ae}/chart.json",
    log:
        "results/{profile}/logs/{recording}/{system}/{stage1}-{ae}/chart.log",
    benchmark:
        "results/{profile}/benchmarks/{recording}/{system}/{stage1}-{ae}/chart.tsv"
    priority: 2  # before the models that it is compared with
    conda:
        "../envs/lagsplat.yaml"
    threads: 1
    resources:
        mem_mb=3000,
        runtime=20,
    params:
        cfg=section("chart"),
        before=before("chart"),
        code=script_digest(SCRIPTS / "stage2/chart.py"),
    message:
        "Chart: whiten and measure the latents of {wildcards.system} ({wildcards.recording})"
    script:
        "../scripts/stage2/chart.py"


rule latent:
    input:
        chart=rules.chart.output.chart,
        records=[rules.chart.output.record],
    output:
        pdf="results/{profile}/{recording}/{system}/{stage1}-{ae}/latent.pdf",
        png=report(
            "results/{profile}/{recording}/{system}/{stage1}-{ae}/latent.png",
            caption="../report/latent.rst",
            category="Chart",
            labels={
                "system": "{system}",
                "recording": "{recording}",
                "profile": "{profile}",
            },
        ),
    log:
        "results/{profile}/logs/{recording}/{system}/{stage1}-{ae}/latent.log",
    benchmark:
        "results/{profile}/benchmarks/{recording}/{system}/{stage1}-{ae}/latent.tsv"
    conda:
        "../envs/lagsplat.yaml"
    threads: 1
    resources:
        mem_mb=2000,
        runtime=10,
    params:
        title=section("system.title"),
        before=before("stage2"),
        code=script_digest(SCRIPTS / "stage2/latent.py"),
    message:
        "Draw the latent trajectory of {wildcards.system} ({wildcards.recording})"
    script:
        "../scripts/stage2/latent.py"
