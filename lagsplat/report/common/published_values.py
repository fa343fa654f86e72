"""The numbers of the paper that stand beside ours, labelled as the paper's.

Results as what JSON can hold.
"""

from typing import Any

METHOD = "LaGSplat (paper)"
RECORDING = "filmed, the paper's"
PAPER = {"recording": RECORDING, "profile": "the paper's"}
"""What every row of the paper's own numbers says of where they are from."""
SYSTEM_SCORES = ("d", "frequency_error", "latent_nrmse", "image_ratio", "ae_floor", "mse_half_second")
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


# Table "Krauss": latent dimension, floor, half-second error, frequency error. The released one-segment models
# have eight coordinates, not six.
BASELINES: dict[str, dict[str, tuple[float, ...]]] = {
    "krauss_1seg": {
        "Osc. + deconv": (6, 1.03e-5, 0.246e-3, 0.371),
        "Osc. + ABCD": (6, 3.93e-5, 0.574e-3, 0.550),
        "Koopman + deconv": (6, 1.15e-5, 0.503e-3, 0.103),
        "Koopman + ABCD": (6, 0.67e-5, 0.504e-3, 0.088),
    },
    "krauss_2seg": {
        "Osc. + deconv": (10, 5.43e-5, 22.7e-3, 0.768),
        "Osc. + ABCD": (10, 14.5e-5, 6.56e-3, 0.314),
        "Koopman + deconv": (10, 3.95e-5, 5.66e-3, 0.183),
        "Koopman + ABCD": (10, 5.17e-5, 0.984e-3, 0.083),
    },
}
BASELINE_SCORES = ("d", "ae_floor", "mse_half_second", "frequency_error")
EXTERNAL_FORCES = {"Osc. + deconv": "latent only", "Osc. + ABCD": "at d/2 centres"}


def list_paper_baselines(robots: set[str]) -> list[dict[str, Any]]:
    """The paper's rows of the published baselines, on its filmed recordings.

    Source: paper, Table "Krauss".
    """
    shared = {"dynamics": "linear", **PAPER, "n_seeds": 1}
    rows = []
    for robot in [robot for robot in BASELINES if robot in robots]:
        for name, values in BASELINES[robot].items():
            names = {"robot": robot, "method": f"{name} (paper)"}
            scores = dict(zip(BASELINE_SCORES, values, strict=True))
            rows.append(names | scores | shared | {"external_force": EXTERNAL_FORCES.get(name, "none")})
    return rows


def list_paper_rows(robots: set[str]) -> list[dict[str, Any]]:
    """The paper's own LaGSplat rows for these systems, measured on its filmed recordings.

    The paper gives medians without spread and no count of diverged rollouts, so those cells stay empty.

    Source: paper, Tables "Free rollouts" and "Krauss".
    """
    shared: dict[str, Any] = {"method": METHOD, "dynamics": "nonlinear", "external_force": "anywhere"}
    shared |= {**PAPER, "n_seeds": 5}
    return [
        {"robot": robot, **dict(zip(SYSTEM_SCORES, values, strict=True)), **shared}
        for robot, values in SYSTEMS.items()
        if robot in robots
    ]
