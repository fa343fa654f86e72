rule authors:
    input:
        recording=rules.stage1.input.recording,
        records=rules.views.input.records,
    output:
        frames=update(
            "results/{profile}/{recording}/{system}/authors/predicted.safetensors"
        ),
        record="results/{profile}/{recording}/{system}/authors/predicted.json",
    log:
        "results/{profile}/logs/{recording}/{system}/authors/authors.log",
    benchmark:
        "results/{profile}/benchmarks/{recording}/{system}/authors/authors.tsv"
    conda:
        "../envs/lagsplat.yaml"
    threads: 1
    resources:
        mem_mb=8000,
        runtime=1440,
    params:
        cfg=section("authors"),
        before=before("authors"),
        code=script_digest(SCRIPTS / "baselines/authors.py"),
        # Not an output: what the tool leaves behind is its user's to keep or to delete.
        place="results/{profile}/{recording}/{system}/authors/tool",
    message:
        "The authors' own forecaster on {wildcards.system} ({wildcards.recording})"
    script:
        "../scripts/baselines/authors.py"


rule extrapolate_authors:
    input:
        recording=rules.stage1.input.recording,
        autoencoder=rules.stage1.output.autoencoder,
        chart=rules.chart.output.chart,
        dynamics=rules.stage2.output.dynamics,
        frames=rules.authors.output.frames,
        records=[rules.stage2.output.record, rules.authors.output.record],
    output:
        found=update(
            "results/{profile}/{recording}/{system}/{stage1}-{ae}/{stage2}-{seed}/extrapolation/authors.json"
        ),
        record="results/{profile}/{recording}/{system}/{stage1}-{ae}/{stage2}-{seed}/extrapolation/authors_record.json",
    log:
        "results/{profile}/logs/{recording}/{system}/{stage1}-{ae}/{stage2}-{seed}/extrapolate_authors.log",
    benchmark:
        "results/{profile}/benchmarks/{recording}/{system}/{stage1}-{ae}/{stage2}-{seed}/extrapolate_authors.tsv"
    conda:
        "../envs/lagsplat.yaml"
    threads: 1
    resources:
        mem_mb=2000,
        runtime=30,
    params:
        cfg=section("extrapolation"),
        before=lambda wildcards: [
            before("extrapolate")(wildcards),
            before("authors_read")(wildcards),
        ],
        code=script_digest(SCRIPTS / "extrapolation/extrapolate_authors.py"),
    message:
        "Read what the authors' own forecaster predicts of {wildcards.system} ({wildcards.recording})"
    script:
        "../scripts/extrapolation/extrapolate_authors.py"
