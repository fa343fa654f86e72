CALIBRATION = "results/calibration"


rule calibration_make:
    output:
        data=directory(f"{CALIBRATION}/recordings/{{batch}}"),
    log:
        f"{CALIBRATION}/logs/recordings/{{batch}}.log",
    benchmark:
        f"{CALIBRATION}/benchmarks/recordings/{{batch}}.tsv"
    conda:
        "../envs/lagsplat.yaml"
    threads: 1
    resources:
        mem_mb=2000,
        runtime=30,
    params:
        batch=section("calibration.batch"),
        seed=section("calibration.seed"),
        systems=section("calibration.systems"),
        code=made_of("calibration_make", "benchmarks.gapgen.make", folder="calibration"),
    message:
        "Draw batch {wildcards.batch} of recordings whose truth is known"
    script:
        "../scripts/calibration/calibration_make.py"


rule calibration_measure:
    input:
        data=rules.calibration_make.output.data,
    output:
        measures=f"{CALIBRATION}/measures/{{batch}}.jsonl",
    log:
        f"{CALIBRATION}/logs/measures/{{batch}}.log",
    benchmark:
        f"{CALIBRATION}/benchmarks/measures/{{batch}}.tsv"
    conda:
        "../envs/lagsplat.yaml"
    threads: 1
    resources:
        mem_mb=2000,
        runtime=60,
    params:
        cfg=section("diagnose"),
        code=made_of(
            "calibration_measure",
            "benchmarks.calibration.measure",
            folder="calibration",
        ),
    message:
        "Measure the alternatives on batch {wildcards.batch}"
    script:
        "../scripts/calibration/calibration_measure.py"


rule calibration:
    input:
        measures=lambda wildcards: [
            rules.calibration_measure.output.measures.format(batch=batch)
            for batch in range(
                -(-experiment.calibration.recordings // experiment.calibration.batch)
            )
        ],
    output:
        model=f"{CALIBRATION}/model.json",
        validation=f"{CALIBRATION}/validation.csv",
        measures=f"{CALIBRATION}/measures.jsonl.xz",
    log:
        f"{CALIBRATION}/logs/calibration.log",
    benchmark:
        f"{CALIBRATION}/benchmarks/calibration.tsv"
    conda:
        "../envs/lagsplat.yaml"
    threads: 1
    resources:
        mem_mb=2000,
        runtime=60,
    params:
        code=made_of("calibration", "benchmarks.calibration.fit", folder="calibration"),
    message:
        "Fit the probabilities of the verdict, and check them on what was left out"
    script:
        "../scripts/calibration/calibration.py"
