"""Builds one self-contained HTML page from a session: law, Gaussians and recording as JSON in the page."""

import base64
import html
import json
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float32
from jinja2 import Template

from lagsplat.forces.loaded_lagrangian import make_fast_lagrangian
from lagsplat.io.files.atomic import write_text
from lagsplat.stage2.numpy_lagrangian import ConstantSpd, ConvexNet, NumpyLagrangian, SpdField
from lagsplat.viewer.rendering.overlays import PRESENT, AccelerationField, select_moving, trace_rest_outline
from lagsplat.viewer.simulation.history import RecordedData
from lagsplat.viewer.simulation.session import Session

MECHANICS = ("law.js", "hand.js", "plane.js", "depth.js", "space.js", "session.js")
"""Scripts that also run without a browser."""
SCRIPTS = (*MECHANICS, "splats.js", "chart.js", "pointer.js", "app.js")
LARGEST_BYTES = 15_000_000


def read_asset(name: str) -> str:
    """Read a file of ``lagsplat/viewer/static_page/assets``."""
    return files("lagsplat.viewer.static_page").joinpath("assets", name).read_text(encoding="utf-8")


def render_page(session: Session, *, title: str, subtitle: str) -> str:
    """Render the page of a session as HTML."""
    # only "</" could end a script element early
    run = json.dumps(pack_page(session), allow_nan=False, separators=(",", ":")).replace("</", "<\\/")
    return Template(read_asset("index.html")).render(
        title=html.escape(title),
        subtitle=html.escape(subtitle),
        style=read_asset("style.css"),
        script="\n".join(read_asset(name) for name in SCRIPTS),
        space=session.operating_point.kinematics.space,
        run=run,
    )


def save_page(path: Path, session: Session, *, title: str, subtitle: str) -> None:
    """Write the page of a session to ``path`` atomically.

    Raises:
        ValueError: as `pack_page`, or the page is larger than `LARGEST_BYTES`.
    """
    page = render_page(session, title=title, subtitle=subtitle)
    size = len(page.encode())
    if size > LARGEST_BYTES:
        raise ValueError(
            f"{path}: the page would have {size / 1e6:.1f} MB and at most {LARGEST_BYTES / 1e6:.0f} are "
            "written; train fewer Gaussians for a page"
        )
    write_text(path, page)


FRAMES = 3600  # largest number of recorded frames in a page
TEXEL = 4  # numbers per texel of the texture that holds the Gaussians
SWING = 2.0  # length of the arrow of the fastest recorded motion in cells


def pack_page(session: Session) -> dict[str, Any]:
    """Pack the run of a session as plain data for JSON.

    Raises:
        ValueError: the mass is induced by the decoder, which a page cannot compute.
    """
    operating_point, recorded = session.operating_point, session.recorded
    law = make_fast_lagrangian(operating_point.law)
    if not isinstance(law, NumpyLagrangian):
        raise ValueError(
            "the mass of this run is induced by its decoder: a page does not compute that; export a run "
            "whose mass is learned or constant, or push this one with lagsplat view"
        )
    return {
        "d": operating_point.law.d,
        "dt": session.dt_s,
        "rest": operating_point.rest.tolist(),
        "reach": operating_point.visited_radius,
        "divergence": session.config.divergence,
        "gain": session.grasp_model.gain,
        "brush": session.grasp_model.radius_px,
        "law": pack_law(law),
        "splats": _splats(session),
        "coverage": {
            "points": session.coverage.points.tolist(),
            "root": session.coverage.root.tolist(),
            "radius": session.coverage.radius,
        },
        "inputs": _inputs(session),
        "recorded": _recorded(recorded),
        "outline": [np.round(line, 2).tolist() for line in trace_rest_outline(operating_point)],
        "field": _field(session),
    }


def pack_law(law: NumpyLagrangian) -> dict[str, Any]:
    """Pack the numbers of a law under the names that ``assets/law.js`` reads."""
    names = ("inner", "innerBias", "outer", "outerBias")
    blocks = [dict(zip(names, (part.tolist() for part in block), strict=True)) for block in law.blocks]
    return {
        "unit": law.unit_s,
        # JSON has no infinity
        "longestStep": min(law.longest_step, 1e300),
        "signed": law.signed,
        "blocks": blocks,
        "stiffness": law.stiffness.tolist(),
        "restImage": law.rest_image.tolist(),
        "restSlope": law.rest_slope.tolist(),
        "pressureMap": law.pressure_map.tolist(),
        "curvature": None if law.curvature is None else law.curvature.tolist(),
        "convex": pack_convex_net(law.convex),
        "volume": pack_convex_net(law.volume),
        "mass": pack_spd_field(law.mass),
        "damping": pack_spd_field(law.damping),
    }


def pack_gaussians(session: Session) -> Float32[np.ndarray, "K row"]:
    """Pack the Gaussians in whitened coordinates and pixels of the training resolution, one row each.

    A row holds the position at ``q = 0``, the Jacobian of x, y and, in space, z, offset and factor of the
    gate, opacity, colour and covariance, padded to whole texels.
    """
    kinematics, gaussians = session.operating_point.kinematics, session.operating_point.autoencoder.gaussians
    geometry = kinematics.geometry
    with torch.no_grad():
        color, covariance = gaussians.color_logit.sigmoid().cpu(), gaussians.covariance().cpu()
    latent = geometry.center[..., None]
    parts = [
        kinematics.center - (geometry.jacobian @ latent)[..., 0],
        geometry.jacobian.flatten(1),
        (geometry.precision_factor @ latent)[..., 0],
        geometry.precision_factor.flatten(1),
        geometry.opacity[:, None],
        color.double(),
        covariance.double(),
    ]
    table = torch.cat(parts, 1).float().numpy()
    return np.pad(table, ((0, 0), (0, -table.shape[1] % TEXEL)))


def _splats(session: Session) -> dict[str, Any]:
    kinematics = session.operating_point.kinematics
    table = pack_gaussians(session)
    with torch.no_grad():
        background = session.operating_point.autoencoder.gaussians.background().cpu().tolist()
    return {
        "constants": base64.b64encode(table.astype("<f4").tobytes()).decode(),
        "count": len(table),
        "d": kinematics.d,
        "space": kinematics.space,
        "camera": None if kinematics.space == 2 else _camera(session),
        "background": background,
        "height": kinematics.height,
        "width": kinematics.width,
    }


def _camera(session: Session) -> dict[str, Any]:
    """Pack the recording camera, the Gaussians that can be dragged and their median depth at rest."""
    operating_point, moves = session.operating_point, select_moving(session.operating_point.kinematics)
    visible = moves & (operating_point.kinematics.presence(operating_point.rest[None])[0].numpy() > PRESENT)
    depth = operating_point.kinematics.places(operating_point.rest[None])[0, :, 2].numpy()
    return {
        "lens": operating_point.autoencoder.lens,
        "moves": np.flatnonzero(moves).tolist(),
        "depth": float(np.median(depth[visible if visible.any() else moves])),
    }


def _inputs(session: Session) -> dict[str, Any]:
    recorded, mean = session.recorded, session.operating_point.u.numpy()
    stacked = np.concatenate([recorded.u, mean[None]])
    return {
        "names": list(recorded.names),
        "units": list(recorded.units),
        "mean": mean.tolist(),
        "low": stacked.min(0).tolist(),
        "high": stacked.max(0).tolist(),
    }


def _recorded(recorded: RecordedData) -> dict[str, Any]:
    start, stop = max(recorded.segments, key=lambda clip: clip[1] - clip[0])
    kept = slice(start, min(stop, start + FRAMES))
    columns = {"states": recorded.q[kept], "rates": recorded.v[kept], "rows": recorded.u[kept]}
    return {name: np.round(values, 6).tolist() for name, values in columns.items()}


def _field(session: Session) -> dict[str, Any]:
    field = AccelerationField(session.operating_point)
    swing = np.abs(session.recorded.v).max(0)
    fastest = float(np.linalg.norm(field.along(swing), axis=1).max(initial=1e-12))
    return {"chosen": field.chosen.tolist(), "scale": SWING * field.cell / fastest}


def pack_convex_net(net: ConvexNet | None) -> dict[str, Any] | None:
    """Pack the weights of a convex network as lists; None for no network."""
    if net is None:
        return None
    names = {"first": "first", "firstBias": "first_bias", "second": "second", "secondBias": "second_bias"}
    names |= {"between": "between", "head": "head"}
    return {name: getattr(net, attribute).tolist() for name, attribute in names.items()}


def pack_spd_field(field: SpdField | ConstantSpd) -> dict[str, Any]:
    """Pack a mass or damping matrix as lists; ``net`` is None if it is constant."""
    names = ("first", "firstBias", "second", "secondBias", "third")
    net = None if field.net is None else {n: w.tolist() for n, w in zip(names, field.net, strict=True)}
    return {"lower": field.lower.tolist(), "floor": field.floor, "net": net}
