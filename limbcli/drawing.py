"""Write figures to disk: a PNG to view, an SVG to print, and the plotted data as CSV."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from limbcli.files.plain_text import write_rows
from limbcli.model import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.collections import Collection
    from matplotlib.container import ErrorbarContainer
    from matplotlib.figure import Figure
    from matplotlib.gridspec import GridSpec
    from matplotlib.path import Path as Outline

COLUMNS = ("panel", "x_axis", "y_axis", "kind", "series", "number", "x", "y", "value")
# largest number of pixels of an image that is written as data; a larger one is a picture
_MOST_PIXELS = 40_000
_COLOUR_BAR = "<colorbar>"
_LETTER = 0.6  # mean width of a letter as a fraction of the font size
_PACKED = 3  # zlib's level for a PNG: half the time of its usual 6, for a file about as large
_LINE = 1.3  # line spacing as a multiple of the font size

Row = tuple[object, ...]


def save_figure(figure: Figure, path: Path, *, dpi: float | None = None) -> None:
    """Write `path` (a PNG), and next to it the same figure as SVG and its data as `<name>-data.csv`."""
    save_picture(figure, path, dpi=dpi)
    write_data(figure, data_file(path))


def save_picture(figure: Figure, path: Path, *, dpi: float | None = None) -> None:
    """Write `path` (a PNG) and the same as SVG, without data: for pictures that are not graphs.

    The layout is computed once before both files are drawn; `Figure.savefig` would repeat it for each file.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    own_dpi = figure.dpi
    figure.dpi = own_dpi if dpi is None else dpi
    _lay_out(figure)
    FigureCanvasAgg(figure).print_png(
        path, metadata={"Software": None}, pil_kwargs={"compress_level": _PACKED}
    )
    figure.dpi = own_dpi
    FigureCanvasSVG(figure).print_svg(path.with_suffix(".svg"), metadata={"Date": None, "Creator": "limbcli"})


def put_title(figure: Figure, text: str, *, size: float = 12.0) -> None:
    """Add a title above the whole figure, wrapped to its width.

    size : font size, points
    """
    figure.suptitle("\n".join(title_lines(text, float(figure.get_size_inches()[0]), size)), fontsize=size)


def title_lines(text: str, width_inches: float, size: float) -> list[str]:
    """Wrap a title at `size` points; the mean width of a letter is taken as `_LETTER` times the size."""
    return textwrap.wrap(text, int(72.0 * width_inches / (_LETTER * size)))


@dataclass(frozen=True)
class Margins:
    """Margins around panels of known size, inches: left of all, above each, below all, between two.

    labelled : each panel has its own axis labels, so left and below count for each
    """

    left: float
    above: float
    below: float
    gap: float = 0.08
    labelled: bool = False


def panel_sheet(
    widths: Sequence[float],
    heights: Sequence[float],
    margins: Margins,
    title: str,
    *,
    title_size: float = 12.0,
) -> tuple[Figure, GridSpec]:
    """A titled figure with panels of the given sizes (inches), in columns and rows.

    With known sizes no automatic layout is needed, which takes as long as drawing.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    beside, under = (margins.left, margins.below) if margins.labelled else (0.0, 0.0)
    beside, under = beside + margins.gap, under + margins.gap + margins.above
    across = sum(widths) + (len(widths) - 1) * beside
    down = sum(heights) + (len(heights) - 1) * under
    width = margins.left + across + margins.gap
    lines = title_lines(title, width, title_size)
    top = margins.gap + len(lines) * _LINE * title_size / 72.0 + margins.above
    height = top + down + margins.below
    figure = Figure(figsize=(width, height))
    FigureCanvasAgg(figure)
    figure.suptitle("\n".join(lines), fontsize=title_size, y=1.0 - margins.gap / height)
    grid = figure.add_gridspec(
        len(heights), len(widths), width_ratios=widths, height_ratios=heights,
        left=margins.left / width, right=1.0 - margins.gap / width,
        bottom=margins.below / height, top=1.0 - top / height,
        wspace=beside / float(np.mean(widths)), hspace=under / float(np.mean(heights)),
    )  # fmt: skip
    return figure, grid


def _lay_out(figure: Figure) -> None:
    """Compute the positions of the axes and fix them.

    Done twice, because axes of another size have other ticks, whose labels have another width.
    """
    engine = figure.get_layout_engine()
    if engine is not None:
        engine.execute(figure)
        engine.execute(figure)
        figure.set_layout_engine("none")


def data_file(path: Path) -> Path:
    """Path of the CSV that belongs to a figure.

    >>> data_file(Path("fit.png")).name
    'fit-data.csv'
    """
    return path.with_name(f"{path.stem}-data.csv")


def write_data(figure: Figure, path: Path) -> None:
    """Write everything that is drawn, one row per point: panel, axes, kind, series, its number, x, y, value.

    kind : line, points, cell (of a mesh; its centroid), bar (x, its height) or pixel; with several rows each:
        segment (its ends: error bars, intervals, outlines), span (two opposite corners: shaded ranges, bars
        that are horizontal or do not start at 0), band (the corners of a filled range)
    value : the quantity encoded by its colour, if any
    """
    write_rows(path, COLUMNS, (map(_cell, row) for row in figure_data(figure)))


def figure_data(figure: Figure) -> Iterator[Row]:
    """The rows that `write_data` writes, with unformatted numbers."""
    from matplotlib.container import ErrorbarContainer

    panels = [each for each in figure.axes if each.get_label() != _COLOUR_BAR]
    for k, axes in enumerate(panels, 1):
        names = (str(axes.get_label()) or _title(axes) or k, *_axis_words(axes, figure))
        error_bars = [each for each in axes.containers if isinstance(each, ErrorbarContainer)]
        parts = _lines(axes, error_bars), _collections(axes, error_bars), _bars(axes), _pixels(axes)
        for row in chain(*parts):
            yield (*names, *row)


def _title(axes: Axes) -> str:
    """The title of a panel, whichever of its three positions it has."""
    every = (_plain_words(axes.get_title(at)) for at in ("left", "center", "right"))
    return next((each for each in every if each), "")


def _axis_words(axes: Axes, figure: Figure) -> tuple[str, str]:
    """Axis labels; for shared axes, those of a panel below or beside it, or of the whole figure."""
    own = axes.get_subplotspec()
    below = [
        each for each in axes.get_shared_x_axes().get_siblings(axes) if _are_in_line(own, each, "colspan")
    ]
    beside = [
        each for each in axes.get_shared_y_axes().get_siblings(axes) if _are_in_line(own, each, "rowspan")
    ]
    return (
        _shared([axes, *below], "get_xlabel") or _plain_words(figure.get_supxlabel()),
        _shared([axes, *beside], "get_ylabel") or _plain_words(figure.get_supylabel()),
    )


def _are_in_line(own: Any, other: Axes, span: str) -> bool:
    place = other.get_subplotspec()
    return own is not None and place is not None and getattr(own, span) == getattr(place, span)


def _shared(alike: list[Axes], label: str) -> str:
    return next((_plain_words(text) for each in alike if (text := getattr(each, label)())), "")


def _lines(axes: Axes, error_bars: Sequence[ErrorbarContainer]) -> Iterator[Row]:
    """Lines, except the caps of error bars."""
    caps = {line for each in error_bars for line in each.lines[1]}
    of: dict[Any, Any] = {each.lines[0]: each for each in error_bars}
    for k, line in enumerate(axes.lines):
        if line in caps:
            continue
        x, y = (np.asarray(each, dtype=float) for each in (line.get_xdata(), line.get_ydata()))
        name = _name(of.get(line, line), k)
        x, y = _of_data(line.get_transform(), axes, x, y)
        for n, (a, b) in enumerate(zip(np.ravel(x), np.ravel(y), strict=True)):
            yield "line", name, n, a, b, None


def _collections(axes: Axes, error_bars: Sequence[ErrorbarContainer]) -> Iterator[Row]:
    from matplotlib.collections import LineCollection, TriMesh

    of: dict[Any, Any] = {bars: each for each in error_bars for bars in each.lines[2]}
    for k, each in enumerate(axes.collections):
        array = each.get_array()
        if array is None and isinstance(each, TriMesh):
            continue  # a shaded surface: a picture, not data
        values = np.zeros(0) if array is None else _plain(array).ravel()
        name = _name(of.get(each, each), k)
        if isinstance(each, LineCollection):
            for n, path in enumerate(each.get_paths()):
                yield from (("segment", name, n, x, y, None) for x, y in np.asarray(path.vertices, float))
            continue
        places, kind = _places(each)
        coloured = len(values) == len(places)
        for n, (x, y) in enumerate(places):
            yield kind, name, n, x, y, values[n] if coloured else None


def _places(each: Collection) -> tuple[Array, str]:
    """Positions (n, 2) of the parts of a collection, and their kind."""
    from matplotlib.collections import PathCollection, TriMesh

    if isinstance(each, PathCollection):
        return np.asarray(each.get_offsets(), dtype=float), "points"
    if isinstance(each, TriMesh):  # coloured by interpolation between corners
        grid = each._triangulation  # type: ignore[attr-defined]
        return np.column_stack([grid.x, grid.y]), "points"
    ends = [_corners(path) for path in each.get_paths()]
    if not ends or any(not len(end) for end in ends):
        return np.zeros((0, 2)), "cell"
    if len(ends) == 1 and each.get_array() is None:
        return ends[0], "band"
    return np.array([end.mean(axis=0) for end in ends]), "cell"


def _bars(axes: Axes) -> Iterator[Row]:
    """Bars; a horizontal bar is named by its tick label."""
    from matplotlib.container import BarContainer
    from matplotlib.patches import Rectangle

    groups = [each for each in axes.containers if isinstance(each, BarContainer)]
    lying = {bar for each in groups if each.orientation == "horizontal" for bar in each.patches}
    standing = {bar for each in groups for bar in each.patches} - lying
    ticks = [float(each) for each in axes.get_yticks()] if lying else []
    at = dict(zip(ticks, axes.yaxis.get_major_formatter().format_ticks(ticks), strict=True))
    bars = [each for each in axes.patches if isinstance(each, Rectangle)]
    for n, bar in enumerate(bars):
        left, low, width, height = bar.get_x(), bar.get_y(), bar.get_width(), bar.get_height()
        (left, right), (low, high) = _of_data(
            bar.get_data_transform(), axes, np.array([left, left + width]), np.array([low, low + height])
        )
        if bar in standing and low == 0.0:
            yield "bar", "bars", n, left + width / 2, height, None
            continue
        name = (at.get(round(low + height / 2, 6)) if bar in lying else "") or _name(bar, n)
        yield "span", name, n, left, low, None
        yield "span", name, n, right, high, None


def _of_data(to_picture: Any, axes: Axes, x: Array, y: Array) -> tuple[Array, Array]:
    """Data coordinates; NaN along an axis on which they are fractions of the panel (a line across it)."""
    in_x, in_y = to_picture.contains_branch_seperately(axes.transData)
    unknown = np.full(len(x), np.nan)
    return x if in_x else unknown, y if in_y else unknown


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
    """Vertices (n, 2) of a path, without the repeated first vertex or the CLOSEPOLY of a closed one."""
    corners = np.asarray(path.vertices, dtype=float)
    return corners[:-1] if path.codes is not None and len(corners) > 2 else corners


def _plain(array: Any) -> Array:
    """The array with NaN in place of masked values."""
    return np.asarray(np.ma.filled(np.ma.asarray(array, dtype=float), np.nan), dtype=np.float64)


def _name(artist: Any, k: int) -> str:
    label = str(artist.get_label())
    if not label or label.startswith("_"):
        return f"{k + 1}"
    return _plain_words(label)


def _plain_words(text: str) -> str:
    """A label without math markup, on one line.

    >>> _plain_words(r"$f_\\kappa$ [–]"), _plain_words("cost 1\\\\$,\\nin all")
    ('f_κ [–]', 'cost 1$, in all')
    """
    return " ".join(text.replace(r"$f_\kappa$", "f_κ").replace(r"\$", "$").split())


def _cell(value: object) -> object:
    if value is None or (isinstance(value, float) and not np.isfinite(value)):
        return ""
    return f"{value:.7g}" if isinstance(value, float) else value
