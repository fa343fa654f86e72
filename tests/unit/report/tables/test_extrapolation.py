"""The table of extrapolation, the figure of equilibria, and the comparison of decoders."""

import numpy as np
import pytest

from lagsplat.report.common.printed_table import format_latex
from lagsplat.report.common.style import save_figure
from lagsplat.report.figures.equilibrium import draw_equilibrium
from lagsplat.report.tables.deformation import (
    build_deformation_table,
    draw_jacobian_field,
    lay_out_deformation,
)
from lagsplat.report.tables.extrapolation import (
    AUTHORS,
    FORECASTER,
    FREE,
    OURS,
    build_extrapolation_table,
    group_models,
    lay_out_extrapolation,
)

RUN = {
    "profile": "toy",
    "recording": "simulated",
    "system": "rainbow_rocker",
    "stage1": "default",
    "ae": 0,
    "stage2": "default",
    "seed": 0,
}
DT_S = 1 / 30


def other(kind: str, model: str, trial: int) -> dict:
    return {**RUN, "kind": kind, "model": model, "trial": trial}


def found(*, decay: float = 0.25, level: float = 30.0, diverged: bool = False, reason: str = "") -> dict:
    time_s = DT_S * np.arange(133)
    clip = np.exp(-0.25 * time_s) * np.cos(2 * np.pi * 2.25 * time_s)
    shown = np.exp(-decay * DT_S * np.arange(300)) * np.cos(2 * np.pi * 2.25 * DT_S * np.arange(300)) * 0.4
    late = shown[-60:] * np.exp(-decay * 50)
    nothing = diverged or bool(reason)
    error = None if nothing else abs(decay - 0.25) / 0.25
    looks = [
        {
            "first": 0,
            "time_s": 0.0,
            "states": shown[:, None].tolist(),
            "amplitude": 0.4,
            "late_amplitude": float(np.ptp(shown[-30:]) / 2),
            "energy": (shown**2).tolist(),
        },
        {
            "first": 1800,
            "time_s": 60.0,
            "states": late[:, None].tolist(),
            "amplitude": float(np.ptp(late) / 2),
            "late_amplitude": 0.0,
            "energy": (late**2).tolist(),
        },
    ]
    psnr = {"mean": level, "first": level + 1, "last": level - 1, "per_frame": [level] * 33}
    physics = {
        "frequency_error": None if nothing else -0.004,
        "frequency_error_sigma": 0.001,
        "rate_error": error,
        "rate_error_sigma": 0.05,
        "reason": reason,
    }
    return {
        "recording": {"frames": 133, "held_out": 33, "dt_s": DT_S, "period_s": 0.44},
        "psnr": psnr,
        "aligned": psnr,
        "floor": {"mean": 33.0},
        "physics": physics,
        "left": None if nothing else looks[1]["amplitude"],
        "left_shown": None if nothing else 0.1,
        "range": {"inside": 0.99, "frames": 400},
        "reason": reason,
        "diverged": diverged,
        "looks": looks,
        "start_amplitude": 1.0,
        "clip": clip[:, None].tolist(),
        "equilibrium": [0.0],
    }


@pytest.fixture
def models():
    others = [other("forecaster", "keypoints", n) for n in range(3)] + [other("ode", "default", 0)]
    results = [found(), found(decay=0.0, level=31.0), found(decay=0.02, level=29.0), found(diverged=True)]
    return group_models([RUN], others, [*results, found(decay=0.1)])


def test_medians_ranges_and_what_is_missing_stand_in_the_rows(models) -> None:
    table = build_extrapolation_table(models).set_index(["model", "measure"])
    assert table.loc[(OURS, "psnr_mean"), "value"] == 30.0
    left = table.loc[(FORECASTER, "left")]
    assert (left["n_seeds"], left["n_measured"]) == (3, 2)
    assert left["note"] == "the rollout diverged"
    assert left["low"] < left["value"] < left["high"]
    assert table.loc[(OURS, "frequency_error"), "value"] == 0.004
    assert table.loc[("GaussianPrediction (paper)", "left"), "value"] == 0.53
    assert table.loc[("LaGSplat (paper)", "rate_error"), "recording"] == "filmed, the paper's"
    assert table.loc[(FREE, "energy_left"), "value"] < 1.0


def printed(models, **titles: str) -> str:
    tables = lay_out_extrapolation(build_extrapolation_table(models), titles=titles)
    return "".join(format_latex(table) for table in tables)


def test_the_latex_has_dashes_with_reasons_and_no_number_that_was_not_measured(models) -> None:
    text = printed(models, rainbow_rocker="rainbow rocker")
    assert r"\textsuperscript{1}" in text
    assert "needs CUDA and was not run" in text
    assert "In 2 of 3 seeds: the rollout diverged." in text
    assert "Rainbow rocker (simulated)" in text
    assert "Rainbow rocker (filmed, the paper's)" in text
    with_authors = group_models([RUN], [other("authors", "default", 0)], [found(), found(reason="too dark")])
    assert with_authors[1].model == AUTHORS
    text = printed(with_authors)
    assert "was not run" not in text
    assert "In 0 of 1 seeds: too dark." in text


def test_variants_are_named_and_nothing_is_no_table() -> None:
    named = group_models([], [other("forecaster", "keypoints_noise", 0)], [found()])
    assert named[0].model.endswith("keypoints_noise")
    with pytest.raises(ValueError, match="extrapolated="):
        build_extrapolation_table([])


def test_the_figure_shows_every_model_and_the_minimum(tmp_path) -> None:
    models = {"key-point forecaster": [found(decay=0.0), found(decay=0.02)], "neural ODE": [found(decay=0.1)]}
    figure = draw_equilibrium(found(), models, title="free extrapolation")
    save_figure(tmp_path / "equilibrium.png", figure)
    axes = [axis for part in figure.subfigs for axis in part.axes]
    texts = [text.get_text() for axis in axes for text in axis.texts]
    assert "dashed: minimum of V" in texts
    assert (tmp_path / "equilibrium.png").stat().st_size > 10_000


def decoders() -> dict:
    measures = {"l1": 0.01, "dissimilarity": 0.05, "roughness": 1.0, "speed": 4.0, "painted_still": 0.2}
    measures |= {"painted_moving": 3.0, "parameters": 100, "wall_s": 3.0, "n_gaussians": 40, "steps": 60}
    return {"conditioned": measures, "deformed": measures | {"roughness": None, "parameters": 5000}}


def test_decoders_stand_beside_the_papers(tmp_path) -> None:
    table = build_deformation_table([RUN], [decoders()])
    assert list(table["decoder"]) == ["conditioned", "deformed"] * 2
    assert table["roughness"].tolist()[2:] == [1.4, 6.9]
    text = format_latex(lay_out_deformation(table, titles={"rainbow_rocker": "rainbow rocker"})[0])
    assert "filmed, the paper's" in text
    assert "40 Gaussians" in text
    picture, speed = np.full((3, 8, 12), 0.5, np.float32), np.eye(8, 12, dtype=np.float32)
    maps = {name: {"picture": picture, "speed": n * speed} for n, name in enumerate(decoders(), 1)}
    figure = draw_jacobian_field(maps, decoders(), title="two decoders")
    save_figure(tmp_path / "field.png", figure)
    drawn = [image for axis in figure.axes[:4] for image in axis.images if image.get_array().ndim == 2]
    assert len(drawn) == 2
    assert drawn[0].get_clim() == drawn[1].get_clim()
    assert (tmp_path / "field.png").stat().st_size > 5_000
