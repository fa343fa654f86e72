def sided(wildcards):
    """Whether this run is taught by pictures from other sides."""
    return section("views")(wildcards) is not None


def rig_files(wildcards):
    """The files of the user's rig."""
    views = section("views")(wildcards)
    return files_of_rig(views["rig"]) if views and views["rig"] else []


def spatial(mechanism):
    """Wildcards of the run behind a figure in space."""
    return asdict(planned_spatial(overrides)[mechanism])
