"""Every figure stands on the sheet, under its name, at its own shape, and over no other."""

import pytest
from PIL import Image

from lagsplat.report.common.style import save_figures
from lagsplat.report.figures.contact_sheet import draw_contact_sheet


def test_figures_keep_their_shape_and_their_names(tmp_path):
    shapes = {
        "wide": (400, 100),
        "tall": (100, 300),
        "square": (200, 200),
        "small": (30, 20),
        "last": (90, 60),
    }
    pictures = [(name, Image.new("RGB", size, "red")) for name, size in shapes.items()]
    figure = draw_contact_sheet(pictures, title="All 5 figures")
    assert [axis.get_title(loc="left") for axis in figure.axes] == list(shapes)
    boxes = [axis.get_position().transformed(figure.dpi_scale_trans.frozen()) for axis in figure.axes]
    for axis, (width, height) in zip(figure.axes, shapes.values(), strict=True):
        box, (across, up) = axis.get_position(), figure.get_size_inches()
        assert box.width * across / (box.height * up) == pytest.approx(width / height)
        assert box.y0 > -1e-9
    assert not any(a.overlaps(b) for i, a in enumerate(boxes) for b in boxes[:i])
    save_figures([str(tmp_path / f"sheet.{suffix}") for suffix in ("pdf", "png")], figure)
    assert (tmp_path / "sheet.pdf").stat().st_size
    with Image.open(tmp_path / "sheet.png") as sheet:
        assert sheet.width == 2100


def test_a_sheet_of_nothing_is_refused():
    with pytest.raises(ValueError, match="no figure was planned"):
        draw_contact_sheet([], title="t")
