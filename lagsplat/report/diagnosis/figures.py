"""The figures of a diagnosis, in the order of its report."""

from collections.abc import Callable
from dataclasses import dataclass

import matplotlib as mpl
from matplotlib.figure import Figure

from lagsplat.diagnose.core.result import Diagnosis
from lagsplat.report.common.style import paper_style
from lagsplat.report.diagnosis.content import ReportContent, read_location
from lagsplat.report.diagnosis.figure_hypotheses import (
    draw_components,
    draw_error_budget,
    draw_posterior,
    draw_profiles,
    draw_residual_correlations,
    draw_separability,
    draw_waterfall,
)
from lagsplat.report.diagnosis.figure_residual import draw_forecast_comparison, draw_spectrum, draw_time_strip
from lagsplat.report.diagnosis.figure_state import draw_image_maps, draw_state_maps


@dataclass(frozen=True)
class ReportFigure:
    """A drawn figure with its title and caption; ``figure`` is None where its data were not computed."""

    key: str
    title: str
    caption: str
    figure: Figure | None


CATALOGUE: tuple[tuple[str, str, str, Callable[[Diagnosis, ReportContent], Figure | None]], ...] = (
    (
        "waterfall",
        "How far the gap closes",
        "Root mean square error of held-out forecasts over one natural period, or as long as the sim can "
        "be followed, over each coordinate's own size. From the sim as delivered, over the sim with its "
        "own numbers moved within their uncertainty, to the sim with the chosen effects (whisker: 95 % "
        "interval). The dashed floor is what the true model would leave, given the noise.",
        lambda diagnosis, _: draw_waterfall(diagnosis),
    ),
    (
        "posterior",
        "Which effect",
        "Probability of every candidate; the chosen ones in orange; “none” and “unknown” hatched. To the "
        "right, how much more likely the data are under it than under no effect.",
        lambda diagnosis, _: draw_posterior(diagnosis),
    ),
    (
        "rollouts",
        "Forecasts before and after",
        "Held-out blocks that the sim forecasts worst, in the middle and best, each from a state "
        "estimated on its first ten samples. Grey: measured.",
        lambda diagnosis, _: draw_forecast_comparison(diagnosis),
    ),
    (
        "time",
        "Where in time",
        "The acceleration that the sim lacks, with twice its standard deviation; shaded: spans in which "
        "it stands out, with their share. Below, the stretch between the dotted lines: forecasts of "
        "held-out blocks (vertical lines: new starts).",
        lambda diagnosis, _: draw_time_strip(diagnosis),
    ),
    (
        "components",
        "What kind of term",
        "Share of the residual that each kind of term predicts on blocks left out.",
        lambda diagnosis, _: draw_components(diagnosis),
    ),
    (
        "state",
        "At which positions and velocities",
        "Mean acceleration that the sim lacks. Dots: two standard errors from zero; frames: regions in "
        "which it keeps its sign; grey: hardly visited.",
        lambda diagnosis, _: draw_state_maps(diagnosis),
    ),
    (
        "spectrum",
        "At which frequencies",
        "Left: spectrum of the residual, lines dotted. Right: its coherence with inputs and velocities.",
        lambda diagnosis, _: draw_spectrum(diagnosis),
    ),
    (
        "ladder",
        "At which stage",
        "Error of each stage from the image to the forecast, over its floor (dashed), with its 95 % "
        "interval.",
        lambda _, content: draw_error_budget(content),
    ),
    (
        "picture",
        "Where in the image",
        "Left: squared error of the sim's images beyond what rendering leaves. Right: how well a force "
        "on each point of the body explains the residual, with the force on the best.",
        lambda _, content: draw_image_maps(content),
    ),
    (
        "separability",
        "What this recording distinguishes",
        "Nats by which the recording would prefer the effect of the row, were it there as fitted, over "
        "that of the column, to first order about the fits. Below three, the two cannot be distinguished.",
        lambda _, content: draw_separability(content),
    ),
    (
        "profiles",
        "How sharply the numbers are known",
        "Log-likelihood along each parameter, the others fitted anew; dashed: where a 90 % interval "
        "ends. A flat side is a number without a bound. Orange: fitted value, and the interval that is "
        "reported, which is wider, for no model is exact.",
        draw_profiles,
    ),
    (
        "fingerprint",
        "What the residual goes with",
        "Correlation of the residual force with what may drive it; a white dot marks one that chance "
        "reaches in fewer than 1 of 20 recordings. The largest of a row hints at the kind of effect: "
        "sign v at dry friction, |v| v at drag, q³ at a stiffness that grows, an input at its gain.",
        lambda _, content: draw_residual_correlations(content),
    ),
)
"""Key, title, caption and drawing function of every figure: verdict, place of the gap, certainty."""


def draw_diagnosis_figures(diagnosis: Diagnosis, content: ReportContent) -> list[ReportFigure]:
    """Draw every figure of the report whose data are there."""
    # A dollar in the name of a column or a file is no formula.
    with paper_style(), mpl.rc_context({"text.parse_math": False}):
        figures = [
            ReportFigure(key, title, _choose_caption(key, caption, diagnosis), draw(diagnosis, content))
            for key, title, caption, draw in CATALOGUE
        ]
        for drawing in figures:
            if drawing.figure is not None:
                # Labels of ticks are made at the first drawing, which must fall under these settings.
                drawing.figure.draw_without_rendering()
    return figures


def _choose_caption(key: str, caption: str, diagnosis: Diagnosis) -> str:
    if key == "time" and not read_location(diagnosis).get("smoothed"):
        return "Forecasts of held-out blocks (vertical lines: new starts); the residual was not computed."
    return caption
