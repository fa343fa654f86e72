"""Where the authors of the baselines keep their weights, and how to get them.

The repository carries no licence: what is in it may be looked at there, and nobody else may hand it on. So
nothing of it is part of this project, and nothing is fetched unless it was asked for.

Source: github.com/UThenrik/visual_oscillators_for_SCR, the last epoch of each run.
"""

import os
from pathlib import Path

from lagsplat.io.download import download

COMMIT = "ef8c5b3f86d02e25c96461d06a8069e45f0d608f"
ADDRESS = f"https://raw.githubusercontent.com/UThenrik/visual_oscillators_for_SCR/{COMMIT}/results/models"
NOTICE = (
    "These weights are of another project, whose repository carries no licence: keep them to yourself. "
    f"Source: {ADDRESS}"
)
FILES: dict[tuple[str, str], tuple[str, str]] = {
    ("krauss_1seg", "osc_deconv"): (
        "20251028_1647_scr_match_1seg_harmonic1d/epoch_300",
        "8a6aa01a9cea79dd460f2a45a596e1f3d2da8d346d6c7d933be82f2f6b7193c3",
    ),
    ("krauss_1seg", "osc_abcd"): (
        "20251029_0441_scr_match_1seg_harmonic2d_vel_attn/further/epoch_300",
        "8d298014ed2f141fd8756f5cb6d453a7c1c30c8fdf0d54d55f23c61c18f058db",
    ),
    ("krauss_1seg", "koopman_deconv"): (
        "20251028_1647_scr_match_1seg_koopman/epoch_300",
        "b35db51a4940264405bc591876653b4e4891d0eb32512d243061ca6388bc702b",
    ),
    ("krauss_1seg", "koopman_abcd"): (
        "20251029_1505_scr_match_1seg_koopman_attn/epoch_300",
        "ba25d8c76e55f9c809136e506a34fbf6506159ab68fc03a0edf113b4f087d8e2",
    ),
    ("krauss_2seg", "osc_deconv"): (
        "20251028_1647_scr_match_2seg_harmonic1d/epoch_300",
        "0fdc0c2b318ce0de37bb487821046d7c07442278d16d462399bb339ab3b3744f",
    ),
    ("krauss_2seg", "osc_abcd"): (
        "20251029_1507_scr_match_2seg_harmonic2d_vel_attn/further/epoch_300",
        "1e094fbfb29a8169bb1bfc39f472abd97a2638c6bab71ed4644976d48bac654e",
    ),
    ("krauss_2seg", "koopman_deconv"): (
        "20251028_1647_scr_match_2seg_koopman/epoch_300",
        "ba8aa6f98d57cca6270ff2ffa25fe4ec2e2e24665217a7cd2b3dfd1cee8fbab6",
    ),
    ("krauss_2seg", "koopman_abcd"): (
        "20251029_1506_scr_match_2seg_koopman_attn/epoch_300",
        "648fcaf8d2b94824454a20b63092689e6f773f2ec9a1b427a01572ff883a3b37",
    ),
}
"""Run and SHA-256 of the weights of each system and each choice of ``conf/baseline``."""


def url_of(system: str, baseline: str) -> str:
    """Address of the published weights of ``baseline`` for ``system``."""
    return f"{ADDRESS}/{FILES[system, baseline][0]}/model_checkpoint.pt"


def fetch_weights(folder: str | os.PathLike[str]) -> list[Path]:
    """All published weights as ``folder/SYSTEM/BASELINE.pt``, for ``baseline.weights=folder``; checked.

    Raises:
        ValueError, FileExistsError, ConnectionError, OSError: as `lagsplat.io.download.download`.
    """
    return [
        download(url_of(system, name), Path(folder) / system / f"{name}.pt", sha256=digest)
        for (system, name), (_, digest) in FILES.items()
    ]
