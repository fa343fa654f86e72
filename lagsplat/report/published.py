"""The numbers of the paper that stand beside ours, labelled as the paper's."""

from typing import Any

METHOD = "LaGSplat (paper)"
RECORDING = "filmed, the paper's"
PROFILE = "the paper's, median of five seeds"


def paper_rows(robots: set[str]) -> list[dict[str, Any]]:
    """The paper's own LaGSplat rows for these robots, measured on its filmed recordings.

    The paper gives medians without spread and no count of diverged rollouts, so those cells stay empty.

    Source: paper, Table "Krauss" and Table of latent and image errors.
    """
    shared = {
        "method": METHOD,
        "dynamics": "nonlinear",
        "external_force": "anywhere",
        "recording": RECORDING,
        "profile": PROFILE,
        "n_seeds": 5,
    }
    one = {
        "robot": "krauss_1seg",
        "d": 2,
        "ae_floor": 1.25e-5,
        "mse_half_second": 0.786e-3,
        "frequency_error": 0.314,
        "latent_nrmse": 0.299,
        "image_ratio": 61.3,
    }
    two = {
        "robot": "krauss_2seg",
        "d": 4,
        "ae_floor": 6.31e-5,
        "mse_half_second": 0.769e-3,
        "frequency_error": 0.057,
        "latent_nrmse": 0.273,
        "image_ratio": 33.2,
    }
    return [{**row, **shared} for row in (one, two) if row["robot"] in robots]
