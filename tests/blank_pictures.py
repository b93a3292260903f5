"""Blank pictures for tests that look at none: drawing takes half of a stage's time, most of it for text.

Graphs are made and their data written as always; only what is drawn of them is left out. Pictures that are no
graphs, without data of their own, are not even begun: their panels cost as much as the rest of a small stage.
Tests with the mark `drawn`, and all that runs in other processes, draw.
"""

from __future__ import annotations

import functools
import struct
import sys
import zlib
from pathlib import Path
from typing import Any

import pytest
from matplotlib import cbook
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG

from limbcli import drawing

# Where a stage calls a picture that is no graph.
CALLS = (
    ("limbcli.stages.segment", "contact_sheet"),
    ("limbcli.stages.segmenting.possible_sites", "draw_places"),
    ("limbcli.stages.segmenting.assumed", "draw_assumed"),
    ("limbcli.stages.mesh", "mesh_picture"),
    ("limbcli.stages.limb", "limb_picture"),
    ("limbcli.site_model.element_fibres", "fibre_picture"),
)
_SVG = '<?xml version="1.0" encoding="utf-8"?>\n<svg xmlns="http://www.w3.org/2000/svg" {}/>\n'


def png(width: int, height: int) -> bytes:
    """A white picture, a byte per pixel."""
    rows = height * (b"\0" + width * b"\xff")
    head = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    parts = ((b"IHDR", head), (b"IDAT", zlib.compress(rows, 1)), (b"IEND", b""))
    chunks = (struct.pack(">I", len(b)) + a + b + struct.pack(">I", zlib.crc32(a + b)) for a, b in parts)
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunks)


def svg(width: int, height: int) -> bytes:
    return _SVG.format(f'width="{width}" height="{height}" viewBox="0 0 {width} {height}"').encode()


def blank(really: Any, content: Any) -> Any:
    """In place of a canvas' method; `Figure.savefig`, which wants to see it draw, is left alone."""

    @functools.wraps(really)
    def printed(canvas: Any, target: Any, *more: Any, **options: Any) -> None:
        if canvas.is_saving():
            really(canvas, target, *more, **options)
            return
        width, height = (max(1, round(float(each))) for each in canvas.figure.bbox.size)
        with cbook.open_file_cm(target, "wb") as stream:
            stream.write(content(width, height))

    return printed


def not_begun(*given: Any, **options: Any) -> None:
    """In place of a function that draws to the one path among its arguments."""
    (path,) = (each for each in (*given, *options.values()) if isinstance(each, Path))
    path.write_bytes(png(8, 8))
    path.with_suffix(".svg").write_bytes(svg(8, 8))


def leave_blank(patch: pytest.MonkeyPatch) -> None:
    """From now on pictures are blank, until `patch.undo()`."""
    for canvas, name, content in ((FigureCanvasAgg, "print_png", png), (FigureCanvasSVG, "print_svg", svg)):
        patch.setattr(canvas, name, blank(getattr(canvas, name), content))
    patch.setattr(drawing, "_lay_out", lambda figure: figure.set_layout_engine("none"))
    for module, name in CALLS:
        if module in sys.modules:  # one that is imported later draws
            patch.setattr(sys.modules[module], name, not_begun)
