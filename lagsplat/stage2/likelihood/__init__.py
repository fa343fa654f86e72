"""Maximum likelihood of polynomial laws: priors, guard, multiple shooting, the order of fits, intervals."""
