rule extrapolation:
    input:
        runs=lambda wildcards: some(
            extrapolation_files("run", rules.extrapolate.output.found)
        ),
        forecasters=extrapolation_files(
            "forecaster", rules.extrapolate_forecaster.output.found
        ),
        odes=extrapolation_files("ode", rules.extrapolate_ode.output.found),
        trivial=extrapolation_files("trivial", TRIVIAL_FOUND),
        authors=extrapolation_files("authors", rules.extrapolate_authors.output.found),
        records=[
            *extrapolation_files("run", rules.extrapolate.output.record),
            *extrapolation_files(
                "forecaster", rules.extrapolate_forecaster.output.record
            ),
            *extrapolation_files("ode", rules.extrapolate_ode.output.record),
            *extrapolation_files("trivial", rules.extrapolate_trivially.output.record),
            *extrapolation_files("authors", rules.extrapolate_authors.output.record),
        ],
    output:
        tex="results/tables/extrapolation.tex",
        appendix="results/tables/extrapolation_appendix.tex",
        csv="results/tables/extrapolation.csv",
        html=report(
            "results/tables/extrapolation.html",
            caption="../report/extrapolation.rst",
            category="Tables",
            labels={"table": "extrapolation"},
        ),
    log:
        "results/logs/extrapolation.log",
    benchmark:
        "results/benchmarks/extrapolation.tsv"
    conda:
        "../envs/lagsplat.yaml"
    threads: 1
    resources:
        mem_mb=1500,
        runtime=10,
    params:
        runs=lambda wildcards: plan.extrapolated()[0],
        others=lambda wildcards: plan.extrapolated()[1],
        titles=lambda wildcards: plan.titles(plan.extrapolated()[0]),
        before=lambda wildcards: before_extrapolations(),
        code=script_digest(SCRIPTS / "extrapolation/extrapolation.py"),
    message:
        "Compare the models past their training frames"
    script:
        "../scripts/extrapolation/extrapolation.py"


rule equilibrium:
    input:
        runs=lambda wildcards: some(
            [
                rules.extrapolate.output.found.format(**run)
                for run in first_extrapolated("run")
            ]
        ),
        forecasters=[
            rules.extrapolate_forecaster.output.found.format(**run)
            for run in first_extrapolated("forecaster")
        ],
        odes=[
            rules.extrapolate_ode.output.found.format(**run)
            for run in first_extrapolated("ode")
        ],
    output:
        pdf="results/figures/equilibrium.pdf",
        png=report(
            "results/figures/equilibrium.png",
            caption="../report/equilibrium.rst",
            category="Rollouts",
            labels={"figure": "free extrapolation"},
        ),
    log:
        "results/logs/equilibrium.log",
    benchmark:
        "results/benchmarks/equilibrium.tsv"
    conda:
        "../envs/lagsplat.yaml"
    threads: 1
    resources:
        mem_mb=1500,
        runtime=10,
    params:
        title=lambda wildcards: "Free extrapolation far past the clip · {title} · {recording} recording · profile {profile}".format(
            title=plan.titles(first_extrapolated("run"))[
                first_extrapolated("run")[0]["system"]
            ],
            **first_extrapolated("run")[0],
        ),
        before=lambda wildcards: before_extrapolations(),
        code=script_digest(SCRIPTS / "extrapolation/equilibrium.py"),
    message:
        "Draw where long rollouts end"
    script:
        "../scripts/extrapolation/equilibrium.py"
