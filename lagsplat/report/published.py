"""The numbers of the paper that stand beside ours, labelled as the paper's."""

from typing import Any

METHOD = "LaGSplat (paper)"
RECORDING = "filmed, the paper's"
PROFILE = "the paper's, median of five seeds"
SCORES = ("d", "frequency_error", "latent_nrmse", "image_ratio", "ae_floor", "mse_half_second")
# Table "Free rollouts"; of the arms the floor to three digits and the half-second error, Table "Krauss".
SYSTEMS: dict[str, tuple[float | None, ...]] = {
    "pendulum": (1, 0.034, 0.308, 14.5, 0.93e-4, None),
    "rainbow_rocker": (1, 0.012, 0.125, 13.6, 0.35e-4, None),
    "rocking_chair": (1, 0.029, 0.230, 1.1, 1.56e-4, None),
    "hanging_bag": (2, 0.020, 0.150, 1.6, 0.93e-4, None),
    "double_pendulum": (2, 0.060, 0.947, 67.9, 1.39e-4, None),
    "krauss_1seg": (2, 0.314, 0.299, 61.3, 1.25e-5, 0.786e-3),
    "krauss_2seg": (4, 0.057, 0.273, 33.2, 6.31e-5, 0.769e-3),
}


def paper_rows(robots: set[str]) -> list[dict[str, Any]]:
    """The paper's own LaGSplat rows for these systems, measured on its filmed recordings.

    The paper gives medians without spread and no count of diverged rollouts, so those cells stay empty.

    Source: paper, Tables "Free rollouts" and "Krauss".
    """
    shared = {
        "method": METHOD,
        "dynamics": "nonlinear",
        "external_force": "anywhere",
        "recording": RECORDING,
        "profile": PROFILE,
        "n_seeds": 5,
    }
    return [
        {"robot": robot, **dict(zip(SCORES, values, strict=True)), **shared}
        for robot, values in SYSTEMS.items()
        if robot in robots
    ]
