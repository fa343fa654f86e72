"""LeRobot datasets, versions 2.1 and 3.0: their episodes as trajectories, or one camera as a recording."""
