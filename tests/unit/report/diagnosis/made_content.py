"""Everything that a report may show beside a diagnosis, made up."""

from dataclasses import dataclass

import numpy as np

from lagsplat.diagnose.inference.profile_likelihood import ProfileLikelihood, Separability
from lagsplat.diagnose.residual.correlations import ResidualCorrelations
from lagsplat.report.diagnosis.content import ImageErrorMap, ImageForceMap, ReportContent, VideoComparison


@dataclass(frozen=True)
class MadeRung:
    name: str
    value: float
    low: float
    high: float
    floor: float | None


def body(angle, size=(48, 64)):
    """A rod that hangs from the middle of the upper edge, as a picture."""
    rows, columns = np.mgrid[: size[0], : size[1]]
    along = (rows - 4) * np.cos(angle) + (columns - 32) * np.sin(angle)
    across = (columns - 32) * np.cos(angle) - (rows - 4) * np.sin(angle)
    rod = (np.abs(across) < 2.5) & (along > 0) & (along < 36)
    return np.where(rod[..., None], np.array([40, 90, 160]), 235).astype(np.uint8)


def film(n=12):
    angles = 0.7 * np.cos(np.linspace(0.0, 6.0, n))
    made = [np.stack([body(scale * angle) for angle in angles]) for scale in (1.0, 1.3, 1.02)]
    return VideoComparison(*made, frames_per_s=12.0)


def picture_gap():
    films = film()
    square = [(one.astype(float) - films.real) ** 2 for one in (films.sim, films.augmented)]
    excess = (square[0] - square[1]).mean(axis=(0, 3))
    return ImageErrorMap(films.real[0], excess, ((44, 18, 60, 40, 0.41), (4, 18, 20, 40, 0.37)))


def picture_force(localisable=True):
    along = np.linspace(4.0, 34.0, 10)
    points = np.stack([32.0 + along * np.sin(0.7), 4.0 + along * np.cos(0.7)], axis=1)
    explained = np.linspace(0.3, 0.9, 10)
    forces = np.outer(explained, [-0.7, 0.3])
    return ImageForceMap(body(0.7), points, explained, forces, (8, 9) if localisable else (), localisable)


def exhibits():
    rng = np.random.default_rng(5)
    names = ("coulomb_friction", "stribeck_friction", "quadratic_drag", "viscous_damping", "hysteresis")
    nats = 10.0 ** rng.uniform(-0.5, 2.8, (5, 5))
    nats[0, 1] = nats[1, 0] = 0.8
    grid = np.linspace(0.74, 0.87, 11)
    return ReportContent(
        stages=(
            MadeRung("perception", 0.021, 0.02, 0.022, 0.02),
            MadeRung("chart", 0.011, 0.010, 0.012, 0.01),
            MadeRung("one step", 0.016, 0.014, 0.019, 0.011),
            MadeRung("rollout", 0.31, 0.25, 0.36, 0.05),
        ),
        separability=Separability(names, nats),
        profiles=(
            ProfileLikelihood(
                "coulomb_friction", "acceleration", "q1/s^2", grid, -0.5 * ((grid - 0.801) / 0.0185) ** 2
            ),
            ProfileLikelihood(
                "stribeck_friction",
                "velocity",
                "q1/s",
                np.geomspace(0.002, 0.5, 11),
                -(np.maximum(np.linspace(-3, 3, 11), 0.0) ** 2),
            ),
        ),
        correlations=ResidualCorrelations(
            ("q0", "q1"),
            ("u0", "du0", "q", "v", "sign v", "|v| v", "q²", "q³", "t"),
            np.array(
                [[0.4, 0.5, 0.7, 0.9, 0.6, 0.5, 0.3, 0.2, 0.8], [0.3, 0.4, 0.6, 5.2, 9.1, 3.8, 0.7, 0.5, 0.9]]
            ),
        ),
        image_error=picture_gap(),
        image_force=picture_force(),
        video=film(),
        command="lagsplat diagnose sim=sim.csv real=swing.csv out=out",
        stamp={
            "package": "lagsplat",
            "commit": "0" * 40,
            "dirty": False,
            "python": "3.11.9",
            "versions": {"numpy": "2.4.6", "scipy": "1.17.1", "gsplat": None},
            "time_utc": "2030-01-01T00:00:00+00:00",
        },
    )
