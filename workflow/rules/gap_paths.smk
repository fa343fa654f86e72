GENERATOR = (
    "benchmarks.gapgen.keys",
    "benchmarks.gapgen.make",
    "benchmarks.gapgen.seal",
)
SCORER = (
    "benchmarks.gapgen.gather",
    "benchmarks.gapgen.runs",
    "benchmarks.gapgen.score",
)
SPLIT = "results/{profile}/gap_blind/{split}/{tier}"
SPLIT_LOG = SPLIT.replace("{profile}", "{profile}/logs")
SPLIT_COST = SPLIT.replace("{profile}", "{profile}/benchmarks")


wildcard_constraints:
    split="[A-Za-z0-9-]+",
    tier="T[01]",
    method="(?!diagnosis|left_out)[a-z_]+",
    batch="[0-9]+",


def made_of(script, *commands, folder="gap"):
    """Digest of a script and of what it runs, taken when a job is planned and not before."""
    return lambda wildcards: script_digest(SCRIPTS / folder / f"{script}.py", *commands)


def key_file(wildcards):
    """Where the secret of a split stands."""
    return str(Path(section("blind.keys")(wildcards)) / f"{wildcards.split}.key")


def recordings(wildcards):
    """Number of recordings of a split."""
    return section(f"blind.{wildcards.tier.lower()}")(wildcards)


def in_batches(output, number):
    """An input function: an output of as many batches as ``number`` of the wildcards' recordings fill."""

    def files(wildcards):
        n = -(-number(wildcards) // section("blind.batch")(wildcards))
        return [
            output.format(**{**dict(wildcards.items()), "batch": k}) for k in range(n)
        ]

    return files


def left_out_runs(wildcards):
    """Number of recordings that are diagnosed again without their effect, as long as there are so many."""
    return min(section("blind.left_out")(wildcards), recordings(wildcards))


def motions(wildcards):
    """Folder of the trajectories of a batch: as they were made, or as a frozen encoder sees the films."""
    return (
        rules.gap_make.output.data
        if wildcards.tier == "T0"
        else rules.gap_encode.output.motions
    ).format(**wildcards)


def own_number(wildcards):
    """Which batch of the folder that ``motions`` gives is meant."""
    return int(wildcards.batch) if wildcards.tier == "T0" else 0


def planned_tiers():
    """The tiers that the experiment asks for."""
    return [
        tier
        for tier, count in (("T0", experiment.blind.t0), ("T1", experiment.blind.t1))
        if count
    ]
