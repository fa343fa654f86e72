rule guarantee:
    input:
        dynamics=lambda wildcards: [
            rules.stage2.output.dynamics.format(**run) for run in plan.runs()
        ],
        charts=lambda wildcards: [
            rules.chart.output.chart.format(**run) for run in plan.runs()
        ],
        records=lambda wildcards: [
            rules.stage2.output.record.format(**run) for run in plan.runs()
        ],
    output:
        tex="results/tables/guarantee.tex",
        csv="results/tables/guarantee.csv",
        html=report(
            "results/tables/guarantee.html",
            caption="../report/guarantee.rst",
            category="Tables",
            labels={"table": "what no law can break"},
        ),
    log:
        "results/logs/guarantee.log",
    benchmark:
        "results/benchmarks/guarantee.tsv"
    conda:
        "../envs/lagsplat.yaml"
    threads: 1
    resources:
        mem_mb=2000,
        runtime=30,
    params:
        runs=lambda wildcards: plan.runs(),
        titles=lambda wildcards: plan.titles(plan.runs()),
        cfg=lambda wildcards: section("extrapolation.guarantee")(plan.runs()[0]),
        before=lambda wildcards: [before("evaluate")(run) for run in plan.runs()],
        code=script_digest(SCRIPTS / "stage2/guarantee.py"),
    message:
        "Ask every trained law whether it comes to rest from anywhere"
    script:
        "../scripts/stage2/guarantee.py"
