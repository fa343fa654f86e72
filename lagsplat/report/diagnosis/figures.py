"""The figures of a diagnosis, in the order of its report."""

from dataclasses import dataclass

import matplotlib as mpl
from matplotlib.figure import Figure

from lagsplat.diagnose.core.result import Diagnosis
from lagsplat.report.common.style import paper_style
from lagsplat.report.diagnosis import figure_hypotheses, figure_residual, figure_state
from lagsplat.report.diagnosis.content import ReportContent, read_location


@dataclass(frozen=True)
class ReportFigure:
    """A drawn figure with its title and caption; ``figure`` is None where its data were not computed."""

    key: str
    title: str
    caption: str
    figure: Figure | None


CAPTIONS = {
    "waterfall": (
        "How far the gap closes",
        "Root mean square error of held-out forecasts over one natural period, or as long as the sim can "
        "be followed, over each coordinate's own size: of the sim as delivered, with its own numbers moved "
        "within their uncertainty, and with the chosen effects (whisker: 95 % interval). The dashed floor "
        "is what the true model would leave, given the noise and, of a learned law, its own error.",
    ),
    "posterior": (
        "Which effect",
        "Probability of every candidate; the chosen ones in orange; “none” and “unknown” hatched. To the "
        "right, how much more likely the data are under it than under no effect.",
    ),
    "rollouts": (
        "Forecasts before and after",
        "Held-out blocks that the sim forecasts worst, in the middle and best, each from a state "
        "estimated on its first ten samples. Grey: measured.",
    ),
    "time": (
        "Where in time",
        "The acceleration that the sim lacks, with twice its standard deviation; shaded: spans in which "
        "it stands out, with their share. Below, the stretch between the dotted lines: forecasts of "
        "held-out blocks (vertical lines: new starts).",
    ),
    "components": (
        "What kind of term",
        "Probability that the cause changes each kind of term, given that there is one; the rest is of "
        "sensors and clocks.",
    ),
    "state": (
        "At which positions and velocities",
        "Mean acceleration that the sim lacks. Dots: two standard errors from zero; outlined: regions in "
        "which it keeps its sign; grey: hardly visited.",
    ),
    "spectrum": (
        "At which frequencies",
        "Left: spectrum of the residual, lines dotted. Right: its coherence with inputs and velocities.",
    ),
    "ladder": (
        "At which stage",
        "Error of each stage from the measurement to the forecast, over its floor (dashed), with its 95 % "
        "interval.",
    ),
    "picture": (
        "Where in the image",
        "Left: squared error of the sim's images beyond what rendering leaves. Right: how well a force "
        "on each point of the body explains the residual, with the force on the best.",
    ),
    "separability": (
        "What this recording distinguishes",
        "Nats by which the recording would prefer the effect of the row, were it there as fitted, over "
        "that of the column, to first order about the fits. Below three, the two cannot be distinguished.",
    ),
    "profiles": (
        "How sharply the numbers are known",
        "Log-likelihood along each parameter, the others fitted anew; dashed: where a 90 % interval "
        "ends. A flat side is a number without a bound. Orange: fitted value, and the interval that is "
        "reported, which is wider, for no model is exact.",
    ),
    "fingerprint": (
        "What the residual goes with",
        "Correlation of the residual force with what may drive it; a white dot marks one that chance "
        "reaches in fewer than 1 of 20 recordings. The largest of a row hints at the kind of effect: "
        "sign v at dry friction, |v| v at drag, q³ at a stiffness that grows, an input at its gain.",
    ),
}
"""Title and caption of every figure, in the order of the page: verdict, place of the gap, certainty."""


def draw_diagnosis_figures(diagnosis: Diagnosis, content: ReportContent) -> list[ReportFigure]:
    """Draw every figure of the report whose data are there."""
    captions = dict(CAPTIONS)
    if not read_location(diagnosis).get("smoothed"):
        text = "Forecasts of held-out blocks (vertical lines: new starts); the residual was not computed."
        captions["time"] = (CAPTIONS["time"][0], text)
    # A dollar in the name of a column or a file is no formula, in ticks' labels (`encode_svg_uri`) neither.
    with paper_style(), mpl.rc_context({"text.parse_math": False}):
        figures = {
            "waterfall": figure_hypotheses.draw_waterfall(diagnosis),
            "posterior": figure_hypotheses.draw_posterior(diagnosis),
            "rollouts": figure_residual.draw_forecast_comparison(diagnosis),
            "time": figure_residual.draw_time_strip(diagnosis),
            "components": figure_hypotheses.draw_components(diagnosis),
            "state": figure_state.draw_state_maps(diagnosis),
            "spectrum": figure_residual.draw_spectrum(diagnosis),
            "ladder": figure_hypotheses.draw_error_budget(content),
            "picture": figure_state.draw_image_maps(content),
            "separability": figure_hypotheses.draw_separability(content),
            "profiles": figure_hypotheses.draw_profiles(diagnosis, content),
            "fingerprint": figure_hypotheses.draw_residual_correlations(content),
        }
    return [ReportFigure(key, *captions[key], figure) for key, figure in figures.items()]
