rule forces:
    input:
        truth=branch(
            lambda wildcards: wildcards.recording == "simulated",
            then=rules.simulate.output.truth,
            otherwise=[],
        ),
        autoencoder=rules.stage1.output.autoencoder,
        chart=rules.chart.output.chart,
        dynamics=rules.stage2.output.dynamics,
        matter=rules.matter.output.matter,
        records=[rules.stage2.output.record, rules.matter.output.record],
    output:
        metrics=update(
            "results/{profile}/{recording}/{system}/{stage1}-{ae}/{stage2}-{seed}/forces.json"
        ),
    log:
        "results/{profile}/logs/{recording}/{system}/{stage1}-{ae}/{stage2}-{seed}/forces.log",
    benchmark:
        "results/{profile}/benchmarks/{recording}/{system}/{stage1}-{ae}/{stage2}-{seed}/forces.tsv"
    conda:
        "../envs/lagsplat.yaml"
    threads: 1
    resources:
        mem_mb=2000,
        runtime=20,
    params:
        cfg=section("forces"),
        simulation=section("simulation"),
        release=section("release"),
        before=before_push,
        code=script_digest(SCRIPTS / "forces/forces.py"),
    message:
        "Push {wildcards.system} ({wildcards.recording}, {wildcards.stage2}, seed {wildcards.seed}) in the picture"
    script:
        "../scripts/forces/forces.py"


rule force:
    input:
        run=lambda wildcards: [
            output.format(**plan.pushed(wildcards.mechanism))
            for output in (
                rules.stage1.output.autoencoder,
                rules.chart.output.chart,
                rules.stage2.output.dynamics,
                rules.matter.output.matter,
            )
        ],
        records=lambda wildcards: [
            rules.stage2.output.record.format(**plan.pushed(wildcards.mechanism)),
            rules.matter.output.record.format(**plan.pushed(wildcards.mechanism)),
        ],
    output:
        pdf="results/figures/force_{mechanism}.pdf",
        png=report(
            "results/figures/force_{mechanism}.png",
            caption="../report/force.rst",
            category="Forces",
            labels={"system": "{mechanism}"},
        ),
    log:
        "results/logs/force_{mechanism}.log",
    benchmark:
        "results/benchmarks/force_{mechanism}.tsv"
    conda:
        "../envs/lagsplat.yaml"
    threads: 1
    resources:
        mem_mb=2000,
        runtime=10,
    params:
        cfg=lambda wildcards: section("forces")(plan.pushed(wildcards.mechanism)),
        hanging=lambda wildcards: section("system.film_kind")(
            plan.pushed(wildcards.mechanism)
        )
        == "krauss",
        title=lambda wildcards: "Forces in the picture · {recording} recording of {system} · profile {profile}".format(
            **plan.pushed(wildcards.mechanism)
        ),
        before=lambda wildcards: before_push(plan.pushed(wildcards.mechanism)),
        code=script_digest(SCRIPTS / "forces/force.py"),
    message:
        "Draw {wildcards.mechanism} under forces given in the picture"
    script:
        "../scripts/forces/force.py"


rule push_animation:
    input:
        recording=lambda wildcards: rules.stage1.input.recording.format(
            **plan.pushed(wildcards.mechanism)
        ),
        run=rules.force.input.run,
        records=rules.force.input.records,
    output:
        gif=report(
            "results/figures/push_{mechanism}.gif",
            caption="../report/push_animation.rst",
            category="Forces",
            labels={"system": "{mechanism}"},
        ),
    log:
        "results/logs/push_{mechanism}.log",
    benchmark:
        "results/benchmarks/push_{mechanism}.tsv"
    conda:
        "../envs/lagsplat.yaml"
    threads: 1
    resources:
        mem_mb=2000,
        runtime=10,
    params:
        title=lambda wildcards: "{recording} recording of {system} · profile {profile}".format(
            **plan.pushed(wildcards.mechanism)
        ),
        before=lambda wildcards: before_push(plan.pushed(wildcards.mechanism)),
        code=script_digest(SCRIPTS / "forces/push_animation.py"),
    message:
        "Draw {wildcards.mechanism} under a push as a moving picture"
    script:
        "../scripts/forces/push_animation.py"


rule force_map:
    input:
        metrics=lambda wildcards: rules.forces.output.metrics.format(
            **plan.pushed(wildcards.mechanism)
        ),
        run=lambda wildcards: [
            output.format(**plan.pushed(wildcards.mechanism))
            for output in (
                rules.stage1.output.autoencoder,
                rules.chart.output.chart,
                rules.stage2.output.dynamics,
                rules.matter.output.matter,
            )
        ],
    output:
        pdf="results/figures/force_map_{mechanism}.pdf",
        png=report(
            "results/figures/force_map_{mechanism}.png",
            caption="../report/force_map.rst",
            category="Forces",
            labels={"system": "{mechanism}"},
        ),
    log:
        "results/logs/force_map_{mechanism}.log",
    benchmark:
        "results/benchmarks/force_map_{mechanism}.tsv"
    conda:
        "../envs/lagsplat.yaml"
    threads: 1
    resources:
        mem_mb=2000,
        runtime=10,
    params:
        title=lambda wildcards: "Errors of the answers, by where the force acts · {recording} recording of {system} · profile {profile}".format(
            **plan.pushed(wildcards.mechanism)
        ),
        before=lambda wildcards: forces_before([plan.pushed(wildcards.mechanism)]),
        code=script_digest(SCRIPTS / "forces/force_map.py"),
    message:
        "Draw where on {wildcards.mechanism} forces are answered wrongly"
    script:
        "../scripts/forces/force_map.py"


rule force_invariants:
    input:
        metrics=lambda wildcards: [
            rules.forces.output.metrics.format(**run)
            for run in plan.pushable(plan.main_runs())
        ],
        solid=expand(rules.force_space.output.metrics, solid=planned_spatial(overrides)),
    output:
        tex="results/tables/force_invariants.tex",
        csv="results/tables/force_invariants.csv",
        html=report(
            "results/tables/force_invariants.html",
            caption="../report/force_invariants.rst",
            category="Tables",
            labels={"table": "invariants of forces"},
        ),
    log:
        "results/logs/force_invariants.log",
    benchmark:
        "results/benchmarks/force_invariants.tsv"
    conda:
        "../envs/lagsplat.yaml"
    threads: 1
    resources:
        mem_mb=1500,
        runtime=10,
    params:
        runs=lambda wildcards: plan.pushable(plan.main_runs()),
        solid=[asdict(run) for run in planned_spatial(overrides).values()],
        titles=lambda wildcards: plan.titles(
            [
                *plan.pushable(plan.main_runs()),
                *(asdict(run) for run in planned_spatial(overrides).values()),
            ]
        ),
        before=lambda wildcards: [
            forces_before(plan.pushable(plan.main_runs())),
            [before_push(spatial(name)) for name in planned_spatial(overrides)],
        ],
        code=script_digest(SCRIPTS / "forces/force_invariants.py"),
    message:
        "Gather what holds of forces whatever the energy scale is"
    script:
        "../scripts/forces/force_invariants.py"


rule force_truth:
    input:
        metrics=lambda wildcards: [
            rules.forces.output.metrics.format(**run) for run in plan.pushed_runs()
        ],
    output:
        tex="results/tables/force_truth.tex",
        appendix="results/tables/force_truth_appendix.tex",
        csv="results/tables/force_truth.csv",
        html=report(
            "results/tables/force_truth.html",
            caption="../report/force_truth.rst",
            category="Tables",
            labels={"table": "forces against the truth"},
        ),
    log:
        "results/logs/force_truth.log",
    benchmark:
        "results/benchmarks/force_truth.tsv"
    conda:
        "../envs/lagsplat.yaml"
    threads: 1
    resources:
        mem_mb=1500,
        runtime=10,
    params:
        runs=lambda wildcards: plan.pushed_runs(),
        titles=lambda wildcards: plan.titles(plan.pushed_runs()),
        before=lambda wildcards: forces_before(plan.pushed_runs()),
        code=script_digest(SCRIPTS / "forces/force_truth.py"),
    message:
        "Compare the answers to known forces with the true ones"
    script:
        "../scripts/forces/force_truth.py"
