rule simulate:
    output:
        recording=update("results/{profile}/simulated/{system}/recording.safetensors"),
        truth=update("results/{profile}/simulated/{system}/truth.safetensors"),
        record="results/{profile}/simulated/{system}/recording.json",
    log:
        "results/{profile}/logs/simulated/{system}/recording.log",
    benchmark:
        "results/{profile}/benchmarks/simulated/{system}/recording.tsv"
    conda:
        "../envs/lagsplat.yaml"
    threads: 1
    resources:
        mem_mb=2000,
        runtime=20,
    params:
        simulation=section("simulation", recording="simulated"),
        release=section("release", recording="simulated"),
        split=section("recording.split", recording="simulated"),
        code=script_digest(SCRIPTS / "recording/simulate.py"),
    message:
        "Simulate {wildcards.system}"
    script:
        "../scripts/recording/simulate.py"


rule ingest:
    input:
        film=lambda wildcards: files_of(overrides, recording="filmed", **wildcards),
    output:
        recording=update("results/{profile}/filmed/{system}/recording.safetensors"),
        record="results/{profile}/filmed/{system}/recording.json",
    log:
        "results/{profile}/logs/filmed/{system}/recording.log",
    benchmark:
        "results/{profile}/benchmarks/filmed/{system}/recording.tsv"
    conda:
        "../envs/lagsplat.yaml"
    threads: 1
    resources:
        mem_mb=2000,
        runtime=30,
    params:
        cfg=section("recording", recording="filmed"),
        code=script_digest(SCRIPTS / "recording/ingest.py"),
    message:
        "Read and check the recording of {wildcards.system}"
    script:
        "../scripts/recording/ingest.py"
