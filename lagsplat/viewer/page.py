"""A run to be pushed as one page that needs no server and no network."""

import html
import json
from importlib.resources import files
from pathlib import Path

from jinja2 import Template

from lagsplat.io.atomic import write_text
from lagsplat.viewer.page_data import page_data
from lagsplat.viewer.session import Session

MECHANICS = ("law.js", "hand.js", "plane.js", "depth.js", "space.js", "session.js")
"""What needs no browser."""
SCRIPTS = (*MECHANICS, "splats.js", "chart.js", "pointer.js", "app.js")
LARGEST_BYTES = 15_000_000


def page_part(name: str) -> str:
    """A file of ``lagsplat/viewer/page``."""
    return files("lagsplat.viewer").joinpath("page", name).read_text(encoding="utf-8")


def render_page(session: Session, *, title: str, subtitle: str) -> str:
    """The whole page.

    Raises:
        ValueError: as `page_data`.
    """
    # in a script element only "</" could end it early
    run = json.dumps(page_data(session), allow_nan=False, separators=(",", ":")).replace("</", "<\\/")
    return Template(page_part("index.html")).render(
        title=html.escape(title),
        subtitle=html.escape(subtitle),
        style=page_part("style.css"),
        script="\n".join(page_part(name) for name in SCRIPTS),
        space=session.held.kinematics.space,
        run=run,
    )


def save_page(path: Path, session: Session, *, title: str, subtitle: str) -> None:
    """Write the page to ``path``, whole or not at all.

    Raises:
        ValueError: as `page_data`, or a page beyond what mail and phones take.
    """
    page = render_page(session, title=title, subtitle=subtitle)
    size = len(page.encode())
    if size > LARGEST_BYTES:
        raise ValueError(
            f"{path}: the page would have {size / 1e6:.1f} MB and at most {LARGEST_BYTES / 1e6:.0f} are "
            "written; train fewer Gaussians for a page"
        )
    write_text(path, page)
