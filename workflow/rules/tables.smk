rule table:
    input:
        metrics=gathered(krauss_runs, "metrics"),
        simple=simple_predictors(krauss_runs, "metrics"),
        simple_records=simple_predictors(krauss_runs, "record"),
        odes=lambda wildcards: [
            rules.ode_evaluate.output.metrics.format(**run) for run in ode_runs()
        ],
        ode_records=lambda wildcards: [
            rules.ode_evaluate.output.record.format(**run) for run in ode_runs()
        ],
        baselines=lambda wildcards: [
            rules.baseline_evaluate.output.metrics.format(**run)
            for run in baseline_runs()
        ],
        records=gathered(krauss_runs, "record"),
        baseline_records=lambda wildcards: [
            rules.baseline_evaluate.output.record.format(**run)
            for run in baseline_runs()
        ],
    output:
        tex="results/tables/krauss.tex",
        appendix="results/tables/krauss_appendix.tex",
        csv="results/tables/krauss.csv",
        html=report(
            "results/tables/krauss.html",
            caption="../report/table.rst",
            category="Tables",
            labels={"table": "benchmark"},
        ),
    log:
        "results/logs/table.log",
    benchmark:
        "results/benchmarks/table.tsv"
    conda:
        "../envs/lagsplat.yaml"
    threads: 1
    resources:
        mem_mb=1500,
        runtime=10,
    params:
        runs=lambda wildcards: krauss_runs(),
        image_models=lambda wildcards: image_models(krauss_runs()),
        odes=lambda wildcards: ode_runs(),
        baselines=lambda wildcards: baseline_runs(),
        titles=lambda wildcards: titles(krauss_runs()),
        before=lambda wildcards: [
            *(before("table")(run) for run in krauss_runs()),
            *(before("simple_table")(model) for model in image_models(krauss_runs())),
            *(before("peer_table")(run) for run in ode_runs()),
            *(before("baseline_table")(run) for run in baseline_runs()),
        ],
        code=script_digest(SCRIPTS / "report/table.py"),
    message:
        "Gather the scores of every arm in one table"
    script:
        "../scripts/report/table.py"


rule mass:
    input:
        metrics=gathered(mass_runs, "metrics"),
        records=gathered(mass_runs, "record"),
    output:
        tex="results/tables/mass.tex",
        appendix="results/tables/mass_appendix.tex",
        csv="results/tables/mass.csv",
        html=report(
            "results/tables/mass.html",
            caption="../report/mass.rst",
            category="Tables",
            labels={"table": "forms of the mass"},
        ),
    log:
        "results/logs/mass.log",
    benchmark:
        "results/benchmarks/mass.tsv"
    conda:
        "../envs/lagsplat.yaml"
    threads: 1
    resources:
        mem_mb=1500,
        runtime=10,
    params:
        runs=lambda wildcards: mass_runs(),
        titles=lambda wildcards: titles(mass_runs()),
        before=lambda wildcards: [before("table")(run) for run in mass_runs()],
        code=script_digest(SCRIPTS / "report/mass.py"),
    message:
        "Compare the forms of the mass of every arm"
    script:
        "../scripts/report/mass.py"


rule recipes:
    input:
        metrics=gathered(recipe_runs, "metrics"),
        records=gathered(recipe_runs, "record"),
    output:
        tex="results/tables/recipes.tex",
        csv="results/tables/recipes.csv",
        html=report(
            "results/tables/recipes.html",
            caption="../report/recipes.rst",
            category="Tables",
            labels={"table": "recipes"},
        ),
    log:
        "results/logs/recipes.log",
    benchmark:
        "results/benchmarks/recipes.tsv"
    conda:
        "../envs/lagsplat.yaml"
    threads: 1
    resources:
        mem_mb=1500,
        runtime=10,
    params:
        runs=lambda wildcards: recipe_runs(),
        titles=lambda wildcards: titles(recipe_runs()),
        before=lambda wildcards: [before("table")(run) for run in recipe_runs()],
        code=script_digest(SCRIPTS / "report/recipes.py"),
    message:
        "Compare the paper's and the published code's settings with ours"
    script:
        "../scripts/report/recipes.py"


rule physical:
    input:
        metrics=gathered(main_runs, "metrics"),
        simple=simple_predictors(main_runs, "metrics"),
        simple_records=simple_predictors(main_runs, "record"),
        records=gathered(main_runs, "record"),
    output:
        tex="results/tables/physical.tex",
        csv="results/tables/physical.csv",
        html=report(
            "results/tables/physical.html",
            caption="../report/physical.rst",
            category="Tables",
            labels={"table": "free rollouts"},
        ),
    log:
        "results/logs/physical.log",
    benchmark:
        "results/benchmarks/physical.tsv"
    conda:
        "../envs/lagsplat.yaml"
    threads: 1
    resources:
        mem_mb=1500,
        runtime=10,
    params:
        runs=lambda wildcards: main_runs(),
        image_models=lambda wildcards: image_models(main_runs()),
        titles=lambda wildcards: titles(main_runs()),
        before=lambda wildcards: [
            *(before("table")(run) for run in main_runs()),
            *(before("simple_table")(model) for model in image_models(main_runs())),
        ],
        code=script_digest(SCRIPTS / "report/physical.py"),
    message:
        "Gather the free rollouts of every system in one table"
    script:
        "../scripts/report/physical.py"


rule truth:
    input:
        metrics=gathered(true_runs, "metrics"),
        records=gathered(true_runs, "record"),
    output:
        tex="results/tables/truth.tex",
        appendix="results/tables/truth_appendix.tex",
        csv="results/tables/truth.csv",
        html=report(
            "results/tables/truth.html",
            caption="../report/truth.rst",
            category="Tables",
            labels={"table": "against the truth"},
        ),
    log:
        "results/logs/truth.log",
    benchmark:
        "results/benchmarks/truth.tsv"
    conda:
        "../envs/lagsplat.yaml"
    threads: 1
    resources:
        mem_mb=1500,
        runtime=10,
    params:
        runs=lambda wildcards: true_runs(),
        titles=lambda wildcards: titles(true_runs()),
        before=lambda wildcards: [before("table")(run) for run in true_runs()],
        code=script_digest(SCRIPTS / "report/truth.py"),
    message:
        "Compare what was learned of every simulated system with its truth"
    script:
        "../scripts/report/truth.py"


rule margins:
    input:
        metrics=gathered(planned, "metrics"),
        records=gathered(planned, "record"),
    output:
        tex="results/tables/margins.tex",
        csv="results/tables/margins.csv",
        html=report(
            "results/tables/margins.html",
            caption="../report/margins.rst",
            category="Tables",
            labels={"table": "margins over constant coefficients"},
        ),
    log:
        "results/logs/margins.log",
    benchmark:
        "results/benchmarks/margins.tsv"
    conda:
        "../envs/lagsplat.yaml"
    threads: 1
    resources:
        mem_mb=1500,
        runtime=10,
    params:
        runs=lambda wildcards: planned(),
        titles=lambda wildcards: titles(planned()),
        before=lambda wildcards: [before("table")(run) for run in planned()],
        code=script_digest(SCRIPTS / "report/margins.py"),
    message:
        "Compare the dynamics with constant coefficients"
    script:
        "../scripts/report/margins.py"
