"""Figures on disk: a PNG to look at, an SVG to print, and what is drawn as CSV."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from limbcli.model import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.path import Path as Outline

COLUMNS = ("panel", "x_axis", "y_axis", "kind", "series", "number", "x", "y", "value")
_MOST_PIXELS = 40_000  # of one picture; a larger one is an image, not data
_COLOUR_BAR = "<colorbar>"

Row = tuple[object, ...]


def save_figure(figure: Figure, path: Path, *, dpi: float | None = None) -> None:
    """Write `path` (a PNG), and beside it the same as SVG, and its data as `<name>-data.csv`."""
    save_picture(figure, path, dpi=dpi)
    write_data(figure, data_file(path))


def save_picture(figure: Figure, path: Path, *, dpi: float | None = None) -> None:
    """Write `path` (a PNG), and beside it the same as SVG: what is to be looked at, and is no graph.

    It is laid out once and drawn twice; `Figure.savefig` goes through it once more for each file.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    own_dpi = figure.dpi
    figure.dpi = own_dpi if dpi is None else dpi
    _lay_out(figure)
    FigureCanvasAgg(figure).print_png(path, metadata={"Software": None})
    figure.dpi = own_dpi
    FigureCanvasSVG(figure).print_svg(path.with_suffix(".svg"), metadata={"Date": None, "Creator": "limbcli"})


def _lay_out(figure: Figure) -> None:
    """Places for its axes; as they are laid out, they stay."""
    engine = figure.get_layout_engine()
    if engine is not None:
        engine.execute(figure)
        figure.set_layout_engine("none")


def data_file(path: Path) -> Path:
    """
    >>> data_file(Path("fit.png")).name
    'fit-data.csv'
    """
    return path.with_name(f"{path.stem}-data.csv")


def write_data(figure: Figure, path: Path) -> None:
    """Everything that is drawn, a row a point: panel, axes, kind of mark, series, its number, x, y, value.

    kind : line, points, cell (of a mesh; its middle), bar (x, its height) or pixel
    value : what its colour stands for, where it has one
    """
    with path.open("w", newline="", encoding="utf-8") as stream:
        table = csv.writer(stream)
        table.writerow(COLUMNS)
        for row in figure_data(figure):
            table.writerow([_cell(each) for each in row])


def figure_data(figure: Figure) -> Iterator[Row]:
    """Rows as `write_data` leaves them, with numbers as they are."""
    panels = [each for each in figure.axes if each.get_label() != _COLOUR_BAR]
    for k, axes in enumerate(panels, 1):
        names = (axes.get_title() or k, axes.get_xlabel(), axes.get_ylabel())
        for row in (*_lines(axes), *_collections(axes), *_bars(axes), *_pixels(axes)):
            yield (*names, *row)


def _lines(axes: Axes) -> Iterator[Row]:
    for k, line in enumerate(axes.lines):
        x, y = (np.asarray(each, dtype=float) for each in (line.get_xdata(), line.get_ydata()))
        for n, (a, b) in enumerate(zip(np.ravel(x), np.ravel(y), strict=True)):
            yield "line", _name(line, k), n, a, b, None


def _collections(axes: Axes) -> Iterator[Row]:
    from matplotlib.collections import PathCollection

    for k, each in enumerate(axes.collections):
        array = each.get_array()
        values = np.zeros(0) if array is None else _plain(array).ravel()
        if isinstance(each, PathCollection):
            places, kind = np.asarray(each.get_offsets(), dtype=float), "points"
        else:
            ends = [_corners(path) for path in each.get_paths()]
            if not ends or any(not len(end) for end in ends):
                continue
            places, kind = np.array([end.mean(axis=0) for end in ends]), "cell"
        coloured = len(values) == len(places)
        for n, (x, y) in enumerate(places):
            yield kind, _name(each, k), n, x, y, values[n] if coloured else None


def _bars(axes: Axes) -> Iterator[Row]:
    from matplotlib.patches import Rectangle

    bars = [each for each in axes.patches if isinstance(each, Rectangle)]
    for n, bar in enumerate(bars):
        yield "bar", "bars", n, bar.get_x() + bar.get_width() / 2, bar.get_y() + bar.get_height(), None


def _pixels(axes: Axes) -> Iterator[Row]:
    for k, image in enumerate(axes.images):
        values = _plain(image.get_array())
        if values.ndim != 2 or values.size > _MOST_PIXELS:
            continue
        left, right, bottom, top = image.get_extent()
        n_rows, n_columns = values.shape
        ys = bottom + (np.arange(n_rows) + 0.5) / n_rows * (top - bottom)
        xs = left + (np.arange(n_columns) + 0.5) / n_columns * (right - left)
        rows = ys if image.origin == "lower" else ys[::-1]
        for i, y in enumerate(rows):
            for j, x in enumerate(xs):
                yield "pixel", _name(image, k), i * n_columns + j, x, y, values[i, j]


def _corners(path: Outline) -> Array:
    """Its corners (n, 2); a closed one names the first twice, or ends with a stop that is no corner."""
    corners = np.asarray(path.vertices, dtype=float)
    return corners[:-1] if path.codes is not None and len(corners) > 2 else corners


def _plain(array: Any) -> Array:
    """NaN where a masked array hides what it has."""
    return np.asarray(np.ma.filled(np.ma.asarray(array, dtype=float), np.nan), dtype=np.float64)


def _name(artist: Any, k: int) -> str:
    label = str(artist.get_label())
    if not label or label.startswith("_"):
        return f"{k + 1}"
    return label.replace(r"\$", "$").strip()


def _cell(value: object) -> object:
    if value is None or (isinstance(value, float) and not np.isfinite(value)):
        return ""
    return f"{value:.7g}" if isinstance(value, float) else value
