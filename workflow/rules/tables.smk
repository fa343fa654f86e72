rule table:
    input:
        metrics=gathered(plan.krauss_runs, "metrics"),
        simple=simple_predictors(plan.krauss_runs, "metrics"),
        simple_records=simple_predictors(plan.krauss_runs, "record"),
        odes=lambda wildcards: [
            rules.ode_evaluate.output.metrics.format(**run) for run in plan.ode_runs()
        ],
        ode_records=lambda wildcards: [
            rules.ode_evaluate.output.record.format(**run) for run in plan.ode_runs()
        ],
        baselines=lambda wildcards: [
            rules.baseline_evaluate.output.metrics.format(**run)
            for run in plan.baseline_runs()
        ],
        records=gathered(plan.krauss_runs, "record"),
        baseline_records=lambda wildcards: [
            rules.baseline_evaluate.output.record.format(**run)
            for run in plan.baseline_runs()
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
        runs=lambda wildcards: plan.krauss_runs(),
        image_models=lambda wildcards: list_image_models(plan.krauss_runs()),
        odes=lambda wildcards: plan.ode_runs(),
        baselines=lambda wildcards: plan.baseline_runs(),
        titles=lambda wildcards: plan.titles(plan.krauss_runs()),
        before=lambda wildcards: [
            *(before("table")(run) for run in plan.krauss_runs()),
            *(
                before("simple_table")(model)
                for model in list_image_models(plan.krauss_runs())
            ),
            *(before("peer_table")(run) for run in plan.ode_runs()),
            *(before("baseline_table")(run) for run in plan.baseline_runs()),
        ],
        code=script_digest(SCRIPTS / "report/table.py"),
    message:
        "Gather the scores of every arm in one table"
    script:
        "../scripts/report/table.py"


rule mass:
    input:
        metrics=gathered(plan.mass_runs, "metrics"),
        records=gathered(plan.mass_runs, "record"),
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
        runs=lambda wildcards: plan.mass_runs(),
        titles=lambda wildcards: plan.titles(plan.mass_runs()),
        before=lambda wildcards: [before("table")(run) for run in plan.mass_runs()],
        code=script_digest(SCRIPTS / "report/mass.py"),
    message:
        "Compare the forms of the mass of every arm"
    script:
        "../scripts/report/mass.py"


rule recipes:
    input:
        metrics=gathered(plan.recipe_runs, "metrics"),
        records=gathered(plan.recipe_runs, "record"),
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
        runs=lambda wildcards: plan.recipe_runs(),
        titles=lambda wildcards: plan.titles(plan.recipe_runs()),
        before=lambda wildcards: [before("table")(run) for run in plan.recipe_runs()],
        code=script_digest(SCRIPTS / "report/recipes.py"),
    message:
        "Compare the paper's and the published code's settings with ours"
    script:
        "../scripts/report/recipes.py"


rule physical:
    input:
        metrics=gathered(plan.main_runs, "metrics"),
        simple=simple_predictors(plan.main_runs, "metrics"),
        simple_records=simple_predictors(plan.main_runs, "record"),
        records=gathered(plan.main_runs, "record"),
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
        runs=lambda wildcards: plan.main_runs(),
        image_models=lambda wildcards: list_image_models(plan.main_runs()),
        titles=lambda wildcards: plan.titles(plan.main_runs()),
        before=lambda wildcards: [
            *(before("table")(run) for run in plan.main_runs()),
            *(
                before("simple_table")(model)
                for model in list_image_models(plan.main_runs())
            ),
        ],
        code=script_digest(SCRIPTS / "report/physical.py"),
    message:
        "Gather the free rollouts of every system in one table"
    script:
        "../scripts/report/physical.py"


rule truth:
    input:
        metrics=gathered(plan.true_runs, "metrics"),
        records=gathered(plan.true_runs, "record"),
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
        runs=lambda wildcards: plan.true_runs(),
        titles=lambda wildcards: plan.titles(plan.true_runs()),
        before=lambda wildcards: [before("table")(run) for run in plan.true_runs()],
        code=script_digest(SCRIPTS / "report/truth.py"),
    message:
        "Compare what was learned of every simulated system with its truth"
    script:
        "../scripts/report/truth.py"


rule margins:
    input:
        metrics=gathered(plan.runs, "metrics"),
        records=gathered(plan.runs, "record"),
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
        runs=lambda wildcards: plan.runs(),
        titles=lambda wildcards: plan.titles(plan.runs()),
        before=lambda wildcards: [before("table")(run) for run in plan.runs()],
        code=script_digest(SCRIPTS / "report/margins.py"),
    message:
        "Compare the dynamics with constant coefficients"
    script:
        "../scripts/report/margins.py"
