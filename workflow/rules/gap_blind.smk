rule gap_make:
    output:
        data=directory(f"{SPLIT}/data"),
        answers=f"{SPLIT}/answers.jsonl.enc",
        seal=report(
            f"{SPLIT}/SEAL.json",
            caption="../report/gap_seal.rst",
            category="Blind check",
            labels={"file": "seal", "split": "{split}", "tier": "{tier}"},
        ),
        record=f"{SPLIT}/gap_make.json",
    log:
        f"{SPLIT_LOG}/gap_make.log",
    benchmark:
        f"{SPLIT_COST}/gap_make.tsv"
    conda:
        "../envs/lagsplat.yaml"
    threads: 2
    resources:
        mem_mb=2000,
        runtime=minutes(toy=10, quick=60, full=240),
    params:
        key=key_file,
        n=recordings,
        systems=section("blind.systems"),
        code=made_of("gap_make", *GENERATOR),
    message:
        "Draw split {wildcards.split} ({wildcards.tier}) of recordings with withheld effects, and seal it"
    script:
        "../scripts/gap/gap_make.py"


rule gap_encode:
    input:
        data=rules.gap_make.output.data,
        seal=rules.gap_make.output.seal,
    output:
        motions=directory(f"{SPLIT}/motions/{{batch}}"),
        record=f"{SPLIT}/motions/{{batch}}.json",
    log:
        f"{SPLIT_LOG}/motions/{{batch}}.log",
    benchmark:
        f"{SPLIT_COST}/motions/{{batch}}.tsv"
    conda:
        "../envs/lagsplat.yaml"
    threads: 1
    resources:
        mem_mb=4000,
        runtime=60,
    params:
        stage1=section("stage1"),
        film=lambda wildcards: {
            "steps": section("blind.film_steps")(wildcards),
            "n_gaussians": section("blind.film_gaussians")(wildcards),
        },
        chart=section("chart"),
        size=section("blind.batch"),
        code=made_of("gap_encode"),
    message:
        "An autoencoder of each nominal film in batch {wildcards.batch} of {wildcards.split}, and what it sees"
    script:
        "../scripts/gap/gap_encode.py"


rule gap_predict:
    input:
        data=motions,
        seal=rules.gap_make.output.seal,
    output:
        said=directory(f"{SPLIT}/predictions/diagnosis/{{batch}}"),
    log:
        f"{SPLIT_LOG}/predictions/diagnosis/{{batch}}.log",
    benchmark:
        f"{SPLIT_COST}/predictions/diagnosis/{{batch}}.tsv"
    conda:
        "../envs/lagsplat.yaml"
    threads: 1
    resources:
        mem_mb=2000,
        runtime=120,
    params:
        cfg=section("diagnose"),
        number=own_number,
        size=section("blind.batch"),
        code=made_of("gap_predict"),
    message:
        "Diagnose batch {wildcards.batch} of split {wildcards.split} ({wildcards.tier})"
    script:
        "../scripts/gap/gap_predict.py"


rule gap_baseline:
    input:
        data=motions,
        seal=rules.gap_make.output.seal,
    output:
        said=directory(f"{SPLIT}/predictions/{{method}}/{{batch}}"),
    log:
        f"{SPLIT_LOG}/predictions/{{method}}/{{batch}}.log",
    benchmark:
        f"{SPLIT_COST}/predictions/{{method}}/{{batch}}.tsv"
    conda:
        "../envs/lagsplat.yaml"
    threads: 1
    resources:
        mem_mb=2000,
        runtime=120,
    params:
        cfg=section("diagnose"),
        number=own_number,
        size=section("blind.batch"),
        code=made_of("gap_baseline", "benchmarks.gap_baselines.predict"),
    message:
        "Let {wildcards.method} name the effects of batch {wildcards.batch} of {wildcards.split}"
    script:
        "../scripts/gap/gap_baseline.py"


rule gap_open:
    input:
        seal=rules.gap_make.output.seal,
        said=in_batches(rules.gap_predict.output.said, recordings),
    output:
        # It says which effects are in there: gone as soon as it has served.
        runs=temp(f"{SPLIT}/left_out.jsonl"),
    log:
        f"{SPLIT_LOG}/gap_open.log",
    benchmark:
        f"{SPLIT_COST}/gap_open.tsv"
    conda:
        "../envs/lagsplat.yaml"
    threads: 1
    resources:
        mem_mb=1500,
        runtime=10,
    params:
        key=key_file,
        most=left_out_runs,
        code=made_of("gap_open", *SCORER),
    message:
        "Choose what is diagnosed again without its effect, now that {wildcards.split} is predicted"
    script:
        "../scripts/gap/gap_open.py"


rule gap_left_out:
    input:
        data=branch(
            lambda wildcards: wildcards.tier == "T0",
            then=rules.gap_make.output.data,
            otherwise=in_batches(rules.gap_encode.output.motions, recordings),
        ),
        runs=rules.gap_open.output.runs,
        seal=rules.gap_make.output.seal,
    output:
        said=directory(f"{SPLIT}/predictions/left_out/{{batch}}"),
    log:
        f"{SPLIT_LOG}/predictions/left_out/{{batch}}.log",
    benchmark:
        f"{SPLIT_COST}/predictions/left_out/{{batch}}.tsv"
    conda:
        "../envs/lagsplat.yaml"
    threads: 1
    resources:
        mem_mb=2000,
        runtime=120,
    params:
        cfg=section("diagnose"),
        size=section("blind.batch"),
        code=made_of("gap_left_out"),
    message:
        "Diagnose batch {wildcards.batch} of {wildcards.split} with the true effects left out"
    script:
        "../scripts/gap/gap_left_out.py"


rule gap_score:
    input:
        seal=rules.gap_make.output.seal,
        answers=rules.gap_make.output.answers,
        data=rules.gap_make.output.data,
        diagnosis=in_batches(rules.gap_predict.output.said, recordings),
        left_out=in_batches(rules.gap_left_out.output.said, left_out_runs),
        others=lambda wildcards: [
            path.format(method=method)
            for method in section("blind.baselines")(wildcards)
            for path in in_batches(
                rules.gap_baseline.output.said.replace("{method}", "{{method}}"),
                recordings,
            )(wildcards)
        ],
    output:
        scores=f"{SPLIT}/score/scores.json",
        table=f"{SPLIT}/score/table.csv",
        figures=report(
            expand(
                f"{SPLIT}/score/{{name}}.png",
                name=["confusion", "calibration", "risk_coverage"],
                allow_missing=True,
            ),
            caption="../report/gap_blind.rst",
            category="Blind check",
            labels={"split": "{split}", "tier": "{tier}"},
        ),
        printed=expand(
            f"{SPLIT}/score/{{name}}.pdf",
            name=["confusion", "calibration", "risk_coverage"],
            allow_missing=True,
        ),
    log:
        f"{SPLIT_LOG}/gap_score.log",
    benchmark:
        f"{SPLIT_COST}/gap_score.tsv"
    conda:
        "../envs/lagsplat.yaml"
    threads: 1
    resources:
        mem_mb=2000,
        runtime=10,
    params:
        key=key_file,
        baselines=section("blind.baselines"),
        reveal=section("blind.reveal"),
        code=made_of("gap_score", *SCORER),
    message:
        "Open split {wildcards.split} ({wildcards.tier}) and score its predictions"
    script:
        "../scripts/gap/gap_score.py"


rule gap_blind:
    input:
        scores=lambda wildcards: [
            rules.gap_score.output.scores.format(
                profile=experiment.choices["profile"],
                split=experiment.blind.split,
                tier=tier,
            )
            for tier in planned_tiers()
        ],
    output:
        tex="results/tables/gap_blind.tex",
        appendix="results/tables/gap_blind_appendix.tex",
        csv="results/tables/gap_blind.csv",
        html=report(
            "results/tables/gap_blind.html",
            caption="../report/gap_blind.rst",
            category="Tables",
            labels={"table": "blind check of the diagnosis"},
        ),
    log:
        "results/logs/gap_blind.log",
    benchmark:
        "results/benchmarks/gap_blind.tsv"
    conda:
        "../envs/lagsplat.yaml"
    threads: 1
    resources:
        mem_mb=1500,
        runtime=10,
    params:
        tiers=lambda wildcards: planned_tiers(),
        code=made_of("gap_blind", "benchmarks.gapgen.tiers"),
    message:
        "Gather the blind check in one table"
    script:
        "../scripts/gap/gap_blind.py"
