"""Builds one self-contained HTML page from a session: law, matter, Gaussians and recording as JSON in it."""

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
from torch import Tensor

from lagsplat.forces.answer_spread import LEAST_MOTION_PX, NINE_IN_TEN
from lagsplat.forces.loaded_lagrangian import make_fast_lagrangian
from lagsplat.forces.operating_point import OperatingPoint
from lagsplat.io.files.atomic import write_text
from lagsplat.matter.body_motion import BodyMotion
from lagsplat.matter.field import MatterField
from lagsplat.monomials import ROOM, list_exponents, make_wide_ball
from lagsplat.stage2.decoder_mass import compute_decoder_geometry
from lagsplat.stage2.numpy_lagrangian import (
    ConstantSpd,
    ConvexNet,
    CoordinatesInArrays,
    NumpyLagrangian,
    PolynomialForces,
    PolynomialSpd,
    SpdField,
)
from lagsplat.stage2.polynomials import LOADS, SPRINGS
from lagsplat.viewer.rendering.overlays import AccelerationField, trace_rest_outline
from lagsplat.viewer.simulation.grasp import FOLLOW
from lagsplat.viewer.simulation.session import Session

MECHANICS = ("law.js", "matter.js", "gaussians.js", "plane.js", "depth.js", "space.js", "session.js")
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
        space=session.operating_point.matter.space,
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
        limit = f"{LARGEST_BYTES / 1e6:.0f} MB are the limit; train fewer Gaussians for a page"
        raise ValueError(f"{path}: the page would have {size / 1e6:.1f} MB and {limit}")
    write_text(path, page)


FRAMES = 3600  # largest number of recorded frames in a page
TEXEL = 4  # numbers per texel of the texture that holds the Gaussians
SWING = 2.0  # length of the arrow of the fastest recorded motion in cells


def pack_page(session: Session) -> dict[str, Any]:
    """Pack the run of a session as plain data for JSON.

    Raises:
        ValueError: the mass is induced by the decoder, which a page does not compute.
    """
    operating_point, recorded, grasp_model = session.operating_point, session.recorded, session.grasp_model
    law = make_fast_lagrangian(operating_point.law)
    if not isinstance(law, NumpyLagrangian):
        raise ValueError(
            "a page computes no mass that the decoder induces: export another run, or push this one with "
            "lagsplat view"
        )
    inputs = np.concatenate([recorded.u, operating_point.u.numpy()[None]])
    start, stop = max(recorded.segments, key=lambda clip: clip[1] - clip[0])
    kept = slice(start, min(stop, start + FRAMES))
    columns = {"states": recorded.q[kept], "rates": recorded.v[kept], "rows": recorded.u[kept]}
    field = AccelerationField(operating_point)
    at, along = operating_point.find_lever()
    fastest = field.largest(operating_point.rest.numpy(), np.abs(recorded.v).max(0))
    page = {
        "d": operating_point.law.d,
        "dt": session.dt_s,
        "rest": operating_point.rest,
        "reach": operating_point.visited_radius,
        "divergence": session.config.divergence,
        "brush": grasp_model.radius_px,
        "lever": at,
        "leverWay": along,
        "pull": {
            "follow": FOLLOW,
            "compliance": grasp_model.compliance,
            "leastMobility": grasp_model.least_mobility,
            "farthest": grasp_model.farthest,
            "spread": grasp_model.spread,
            "excess": grasp_model.excess,
            "nineInTen": NINE_IN_TEN,
            "leastMotion": LEAST_MOTION_PX,
        },
        "law": pack_law(law),
        "matter": pack_matter(operating_point.matter),
        "splats": _pack_splats(operating_point),
        "coverage": vars(session.coverage),
        "inputs": {
            "names": recorded.names,
            "units": recorded.units,
            "mean": operating_point.u,
            "low": inputs.min(0),
            "high": inputs.max(0),
        },
        "recorded": {name: np.round(values, 6) for name, values in columns.items()},
        "outline": [np.round(line, 2) for line in trace_rest_outline(operating_point)],
        "field": {"chosen": field.chosen, "scale": SWING * field.cell / fastest},
    }
    return to_plain(page)


def to_plain(value: Any) -> Any:
    """Replace arrays, tensors and tuples by lists, to any depth."""
    if isinstance(value, dict):
        return {name: to_plain(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [to_plain(item) for item in value]
    return value.tolist() if hasattr(value, "tolist") else value


def pack_law(law: NumpyLagrangian) -> dict[str, Any]:
    """Pack the numbers of a law under the names that ``assets/law.js`` reads."""
    names = ("inner", "innerBias", "outer", "outerBias")
    packed = {
        "unit": law.unit_s,
        "longestStep": min(law.longest_step, 1e300),  # JSON has no infinity
        "signed": law.signed,
        "blocks": [dict(zip(names, block, strict=True)) for block in law.blocks],
        "stiffness": law.stiffness,
        "restImage": law.rest_image,
        "restSlope": law.rest_slope,
        "pressureMap": law.pressure_map,
        "curvature": law.curvature,
        "convex": pack_convex_net(law.convex),
        "volume": pack_convex_net(law.volume),
        "mass": pack_spd_field(law.mass),
        "damping": pack_spd_field(law.damping),
        "energy": None if law.energy is None else _pack_energy(law.energy),
        "coordinates": None if law.coordinates is None else _pack_map(law.coordinates),
    }
    return to_plain(packed)


def pack_gaussians(operating_point: OperatingPoint) -> Float32[np.ndarray, "K row"]:
    """Pack the Gaussians in whitened coordinates and pixels of the training resolution, one row each.

    A row holds the position at ``q = 0``, the Jacobian of x, y and, in space, z, offset and factor of the
    gate, opacity, colour and covariance, padded to whole texels.
    """
    gaussians = operating_point.autoencoder.gaussians
    geometry = compute_decoder_geometry(operating_point.autoencoder, operating_point.chart)
    with torch.no_grad():
        color, covariance = gaussians.color_logit.sigmoid().cpu(), gaussians.covariance().cpu()
    latent = geometry.center[..., None]
    parts = [
        gaussians.center.detach().cpu().double() - (geometry.jacobian @ latent)[..., 0],
        geometry.jacobian.flatten(1),
        (geometry.precision_factor @ latent)[..., 0],
        geometry.precision_factor.flatten(1),
        geometry.opacity[:, None],
        color.double(),
        covariance.double(),
    ]
    table = torch.cat(parts, 1).float().numpy()
    return np.pad(table, ((0, 0), (0, -table.shape[1] % TEXEL)))


def _pack_splats(operating_point: OperatingPoint) -> dict[str, Any]:
    autoencoder, table = operating_point.autoencoder, pack_gaussians(operating_point)
    space, places = autoencoder.gaussians.space, operating_point.matter.carry(operating_point.rest[None])[0]
    return {
        "constants": encode_numbers(table, "<f4"),
        "count": len(table),
        "d": operating_point.law.d,
        "space": space,
        "camera": None if space == 2 else {"lens": autoencoder.lens, "depth": places[:, 2].median()},
        "background": autoencoder.gaussians.background().detach().cpu(),
        "height": operating_point.height,
        "width": operating_point.width,
    }


def pack_matter(matter: MatterField) -> dict[str, Any]:
    """Pack the material points [px] and the motion of their bodies as ``assets/matter.js`` reads them."""
    points = encode_numbers(matter.points.numpy(), "<f8")
    return to_plain({"points": points, "body": matter.body, "bodies": [_pack_body(x) for x in matter.bodies]})


def _pack_body(body: BodyMotion) -> dict[str, Any]:
    state = list_exponents(body.d, lowest=1, highest=body.latent_degree)
    place = list_exponents(body.space, lowest=0, highest=body.bending)
    return {
        "center": body.center,
        "size": body.size,
        "state": _pack_monomials(state, body.ball) | {"freeDegree": 1},
        "coefficients": body.coefficients,
        "deviations": body.deviations,
        "place": _pack_monomials(place, make_wide_ball(body.space)) if body.bending else None,
    }


def encode_numbers(numbers: np.ndarray, kind: str) -> str:
    """Encode an array as base64 of the numbers of a NumPy type such as ``<f4``, row by row."""
    return base64.b64encode(numbers.astype(kind).tobytes()).decode()


def pack_convex_net(net: ConvexNet | None) -> dict[str, Any] | None:
    """Pack the weights of a convex network; None for no network."""
    if net is None:
        return None
    names = ("first", "firstBias", "second", "secondBias", "between", "head")
    arrays = (net.first, net.first_bias, net.second, net.second_bias, net.between, net.head)
    return to_plain(dict(zip(names, arrays, strict=True)))


def pack_spd_field(field: SpdField | ConstantSpd | PolynomialSpd) -> dict[str, Any]:
    """Pack a mass or damping matrix; ``net`` is None if it is constant, ``frame`` is one of polynomials."""
    if isinstance(field, PolynomialSpd):
        frame = _pack_monomials(field.exponents, field.ball) | {"coefficients": field.coefficients}
        return to_plain({"inner": field.inner, "floor": field.floor, "frame": frame})
    names = ("first", "firstBias", "second", "secondBias", "third")
    net = None if field.net is None else dict(zip(names, field.net, strict=True))
    return to_plain({"lower": field.lower, "floor": field.floor, "net": net})


def _pack_energy(energy: PolynomialForces) -> dict[str, Any]:
    return {
        "elastic": _pack_monomials(energy.exponents, energy.ball) | {"freeDegree": SPRINGS},
        "pushed": _pack_monomials(energy.input_exponents, energy.ball) | {"freeDegree": LOADS},
        "coefficients": energy.coefficients,
        "inputCoefficients": energy.input_coefficients,
        "atRest": energy.at_rest,
    }


def _pack_map(coordinates: CoordinatesInArrays) -> dict[str, Any]:
    return _pack_monomials(coordinates.exponents, coordinates.ball) | {
        "coefficients": coordinates.coefficients
    }


def _pack_monomials(exponents: np.ndarray | Tensor, ball: np.ndarray | Tensor) -> dict[str, Any]:
    return {"exponents": exponents, "ball": ball, "room": ROOM, "freeDegree": 0}
