rule forecaster:
    input:
        recording=rules.stage1.input.recording,
        records=rules.views.input.records,
    output:
        model=update(
            "results/{profile}/{recording}/{system}/forecasters/{forecaster}-{seed}/model.safetensors"
        ),
        curve=update(
            "results/{profile}/{recording}/{system}/forecasters/{forecaster}-{seed}/curve.csv"
        ),
        record="results/{profile}/{recording}/{system}/forecasters/{forecaster}-{seed}/model.json",
    log:
        "results/{profile}/logs/{recording}/{system}/forecasters/{forecaster}-{seed}/forecaster.log",
    benchmark:
        "results/{profile}/benchmarks/{recording}/{system}/forecasters/{forecaster}-{seed}/forecaster.tsv"
    conda:
        "../envs/lagsplat.yaml"
    threads: 1
    resources:
        mem_mb=2000,
        runtime=minutes(toy=10, quick=60, full=480),
    params:
        cfg=section("forecaster"),
        before=before("forecaster"),
        code=script_digest(SCRIPTS / "baselines/forecaster.py"),
        # Not an output: it must outlive a failed or killed job. A finished one deletes it.
        checkpoint="results/{profile}/{recording}/{system}/forecasters/{forecaster}-{seed}/checkpoint/state.pt",
    message:
        "Forecaster {wildcards.forecaster} of {wildcards.system} ({wildcards.recording}), seed {wildcards.seed}"
    script:
        "../scripts/baselines/forecaster.py"


rule ode:
    input:
        chart=rules.chart.output.chart,
        records=[rules.chart.output.record],
    output:
        model=update(
            "results/{profile}/{recording}/{system}/{stage1}-{ae}/odes/{ode}-{seed}/model.safetensors"
        ),
        curve=update(
            "results/{profile}/{recording}/{system}/{stage1}-{ae}/odes/{ode}-{seed}/curve.csv"
        ),
        record="results/{profile}/{recording}/{system}/{stage1}-{ae}/odes/{ode}-{seed}/model.json",
    log:
        "results/{profile}/logs/{recording}/{system}/{stage1}-{ae}/odes/{ode}-{seed}/ode.log",
    benchmark:
        "results/{profile}/benchmarks/{recording}/{system}/{stage1}-{ae}/odes/{ode}-{seed}/ode.tsv"
    conda:
        "../envs/lagsplat.yaml"
    threads: 1
    resources:
        mem_mb=2000,
        runtime=minutes(toy=10, quick=30, full=60),
    params:
        cfg=section("ode"),
        before=before("ode"),
        code=script_digest(SCRIPTS / "baselines/ode.py"),
        checkpoint="results/{profile}/{recording}/{system}/{stage1}-{ae}/odes/{ode}-{seed}/checkpoint/state.pt",
    message:
        "Differential equation {wildcards.ode} of {wildcards.system} ({wildcards.recording}), seed {wildcards.seed}"
    script:
        "../scripts/baselines/ode.py"


rule ode_evaluate:
    input:
        recording=rules.stage1.input.recording,
        autoencoder=rules.stage1.output.autoencoder,
        chart=rules.chart.output.chart,
        model=rules.ode.output.model,
        records=[rules.chart.output.record, rules.ode.output.record],
    output:
        metrics=update(
            "results/{profile}/{recording}/{system}/{stage1}-{ae}/odes/{ode}-{seed}/metrics.json"
        ),
        record="results/{profile}/{recording}/{system}/{stage1}-{ae}/odes/{ode}-{seed}/evaluate.json",
    log:
        "results/{profile}/logs/{recording}/{system}/{stage1}-{ae}/odes/{ode}-{seed}/evaluate.log",
    benchmark:
        "results/{profile}/benchmarks/{recording}/{system}/{stage1}-{ae}/odes/{ode}-{seed}/evaluate.tsv"
    conda:
        "../envs/lagsplat.yaml"
    threads: 1
    resources:
        mem_mb=3000,
        runtime=20,
    params:
        cfg=section("evaluate"),
        before=before("peer_evaluate"),
        code=script_digest(SCRIPTS / "baselines/ode_evaluate.py"),
    message:
        "Score differential equation {wildcards.ode} of {wildcards.system} ({wildcards.recording}), seed {wildcards.seed}"
    script:
        "../scripts/baselines/ode_evaluate.py"


rule extrapolate:
    input:
        recording=rules.stage1.input.recording,
        autoencoder=rules.stage1.output.autoencoder,
        chart=rules.chart.output.chart,
        dynamics=rules.stage2.output.dynamics,
        records=[
            rules.stage1.output.record,
            rules.chart.output.record,
            rules.stage2.output.record,
        ],
    output:
        found=update(
            "results/{profile}/{recording}/{system}/{stage1}-{ae}/{stage2}-{seed}/extrapolation/run.json"
        ),
        record="results/{profile}/{recording}/{system}/{stage1}-{ae}/{stage2}-{seed}/extrapolation/run_record.json",
    log:
        "results/{profile}/logs/{recording}/{system}/{stage1}-{ae}/{stage2}-{seed}/extrapolate.log",
    benchmark:
        "results/{profile}/benchmarks/{recording}/{system}/{stage1}-{ae}/{stage2}-{seed}/extrapolate.tsv"
    conda:
        "../envs/lagsplat.yaml"
    threads: 1
    resources:
        mem_mb=2000,
        runtime=30,
    params:
        cfg=section("extrapolation"),
        before=before("extrapolate"),
        code=script_digest(SCRIPTS / "extrapolation/extrapolate.py"),
    message:
        "Roll {wildcards.system} ({wildcards.recording}) out far past its training frames, seed {wildcards.seed}"
    script:
        "../scripts/extrapolation/extrapolate.py"


TRIVIAL_FOUND = "results/{profile}/{recording}/{system}/{stage1}-{ae}/{stage2}-{seed}/extrapolation/trivial_{model}-{trial}.json"


rule extrapolate_trivially:
    input:
        recording=rules.stage1.input.recording,
        autoencoder=rules.stage1.output.autoencoder,
        chart=rules.chart.output.chart,
        dynamics=rules.stage2.output.dynamics,
        records=[
            rules.stage1.output.record,
            rules.chart.output.record,
            rules.stage2.output.record,
        ],
    output:
        found=update(expand(TRIVIAL_FOUND, model=TRIVIAL, trial=0, allow_missing=True)),
        record="results/{profile}/{recording}/{system}/{stage1}-{ae}/{stage2}-{seed}/extrapolation/trivial_record.json",
    log:
        "results/{profile}/logs/{recording}/{system}/{stage1}-{ae}/{stage2}-{seed}/extrapolate_trivially.log",
    benchmark:
        "results/{profile}/benchmarks/{recording}/{system}/{stage1}-{ae}/{stage2}-{seed}/extrapolate_trivially.tsv"
    conda:
        "../envs/lagsplat.yaml"
    threads: 1
    resources:
        mem_mb=2000,
        runtime=30,
    params:
        cfg=section("extrapolation"),
        before=before("trivial_read"),
        code=script_digest(SCRIPTS / "extrapolation/extrapolate_trivially.py"),
    message:
        "Carry {wildcards.system} ({wildcards.recording}) on without a trained law, seed {wildcards.seed}"
    script:
        "../scripts/extrapolation/extrapolate_trivially.py"


rule extrapolate_forecaster:
    input:
        recording=rules.stage1.input.recording,
        autoencoder=rules.stage1.output.autoencoder,
        chart=rules.chart.output.chart,
        dynamics=rules.stage2.output.dynamics,
        model="results/{profile}/{recording}/{system}/forecasters/{forecaster}-{trial}/model.safetensors",
        records=[
            rules.stage2.output.record,
            "results/{profile}/{recording}/{system}/forecasters/{forecaster}-{trial}/model.json",
        ],
    output:
        found=update(
            "results/{profile}/{recording}/{system}/{stage1}-{ae}/{stage2}-{seed}/extrapolation/{forecaster}-{trial}.json"
        ),
        record="results/{profile}/{recording}/{system}/{stage1}-{ae}/{stage2}-{seed}/extrapolation/{forecaster}-{trial}_record.json",
    log:
        "results/{profile}/logs/{recording}/{system}/{stage1}-{ae}/{stage2}-{seed}/extrapolate_{forecaster}-{trial}.log",
    benchmark:
        "results/{profile}/benchmarks/{recording}/{system}/{stage1}-{ae}/{stage2}-{seed}/extrapolate_{forecaster}-{trial}.tsv"
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
            before("forecaster_read")(wildcards),
        ],
        code=script_digest(SCRIPTS / "extrapolation/extrapolate_forecaster.py"),
    message:
        "Carry forecaster {wildcards.forecaster}-{wildcards.trial} of {wildcards.system} ({wildcards.recording}) on"
    script:
        "../scripts/extrapolation/extrapolate_forecaster.py"


rule extrapolate_ode:
    input:
        recording=rules.stage1.input.recording,
        autoencoder=rules.stage1.output.autoencoder,
        chart=rules.chart.output.chart,
        dynamics=rules.stage2.output.dynamics,
        model="results/{profile}/{recording}/{system}/{stage1}-{ae}/odes/{ode}-{trial}/model.safetensors",
        records=[
            rules.stage2.output.record,
            "results/{profile}/{recording}/{system}/{stage1}-{ae}/odes/{ode}-{trial}/model.json",
        ],
    output:
        found=update(
            "results/{profile}/{recording}/{system}/{stage1}-{ae}/{stage2}-{seed}/extrapolation/ode_{ode}-{trial}.json"
        ),
        record="results/{profile}/{recording}/{system}/{stage1}-{ae}/{stage2}-{seed}/extrapolation/ode_{ode}-{trial}_record.json",
    log:
        "results/{profile}/logs/{recording}/{system}/{stage1}-{ae}/{stage2}-{seed}/extrapolate_ode_{ode}-{trial}.log",
    benchmark:
        "results/{profile}/benchmarks/{recording}/{system}/{stage1}-{ae}/{stage2}-{seed}/extrapolate_ode_{ode}-{trial}.tsv"
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
            before("ode_read")(wildcards),
        ],
        code=script_digest(SCRIPTS / "extrapolation/extrapolate_ode.py"),
    message:
        "Carry differential equation {wildcards.ode}-{wildcards.trial} of {wildcards.system} ({wildcards.recording}) on"
    script:
        "../scripts/extrapolation/extrapolate_ode.py"
