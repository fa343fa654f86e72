"""Settings of the blind check: how many recordings whose effect is withheld, and what is tried on them."""

from dataclasses import dataclass


@dataclass
class BlindConfig:
    """One sealed split and those who predict it."""

    split: str  # name of the split; one that was opened and revealed is spent, another name draws another
    keys: str  # folder of the secret keys, one a split, outside of everything that predictions may read
    systems: str  # group of mechanisms that the generator draws from
    t0: int  # recordings that are trajectories; 0 leaves this tier out
    t1: int  # recordings that are films; 0 leaves this tier out
    film_steps: int  # of stage 1 on each nominal film
    film_gaussians: int  # that draw it
    batch: int  # recordings a job
    left_out: int  # recordings at most that are diagnosed again with their effect left out of the catalogue
    baselines: list[str]  # other methods in the table
    reveal: bool  # write the outcome of every recording, after which the split is spent

    def __post_init__(self) -> None:
        for name in ("t0", "t1", "left_out"):
            if getattr(self, name) < 0:
                raise ValueError(f"blind.{name}={getattr(self, name)} counts recordings; give 0 or more")
        if self.t0 + self.t1 == 0:
            raise ValueError("blind.t0=0 and blind.t1=0 leave no recording; give one of them a number")
        for name in ("batch", "film_steps", "film_gaussians"):
            if getattr(self, name) < 1:
                raise ValueError(f"blind.{name}={getattr(self, name)} must be at least 1")
        if not self.split.replace("-", "").isalnum():
            raise ValueError(f"blind.split={self.split!r} names a folder; take letters, digits and hyphens")
