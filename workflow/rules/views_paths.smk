def sided(wildcards):
    """Whether this run is taught by pictures from other sides."""
    return section("views")(wildcards) is not None


def rig_files(wildcards):
    """The files of the user's rig."""
    views = section("views")(wildcards)
    return files_of_rig(views["rig"]) if views and views["rig"] else []


def spatial(mechanism):
    """Wildcards of the run behind a figure in space."""
    planned = planned_spatial(overrides)
    if mechanism not in planned:
        raise WorkflowError(
            f"no figure in space of {mechanism!r} here, only of {sorted(planned)}: systems="
            f"{experiment.systems} and spatial={experiment.spatial} leave it out, or the recording is a film; "
            "add its system to systems=[...]"
        )
    return asdict(planned[mechanism])
