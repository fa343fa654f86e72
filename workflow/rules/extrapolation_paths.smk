def extrapolation_files(kind, output):
    """One output for every run of the table of extrapolation, or for every model of a kind beside them."""
    runs, others = plan.extrapolated()
    chosen = runs if kind == "run" else [run for run in others if run["kind"] == kind]
    return [output.format(**run) for run in chosen]


def before_extrapolations():
    """Digest of the settings and code behind all of them."""
    runs, others = plan.extrapolated()
    return [
        *(before("extrapolate_table")(run) for run in runs),
        *(before(f"{run['kind']}_table")(run) for run in others),
    ]


def first_extrapolated(kind):
    """The runs of the system that the figure shows, or its models of a kind."""
    runs, others = plan.extrapolated()
    chosen = runs if kind == "run" else [run for run in others if run["kind"] == kind]
    return [run for run in chosen if run["system"] == runs[0]["system"]]


def planar_runs():
    """The first run of every system of the table of decoders: dynamics play no part in it."""
    seen = {run["system"]: run for run in reversed(plan.extrapolated()[0])}
    return list(reversed(seen.values()))


def some(files):
    """These files; a table or a figure of none is refused."""
    if not files:
        raise WorkflowError(
            f"this would be empty: none of extrapolated={experiment.extrapolated} is among "
            f"systems={experiment.systems}; choose others with extrapolated=[...]"
        )
    return files
