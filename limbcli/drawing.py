"""Figures on disk: a PNG to look at, an SVG to print, and what is drawn as CSV."""

from __future__ import annotations

import csv
import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from limbcli.model import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.collections import Collection
    from matplotlib.figure import Figure
    from matplotlib.gridspec import GridSpec
    from matplotlib.path import Path as Outline

COLUMNS = ("panel", "x_axis", "y_axis", "kind", "series", "number", "x", "y", "value")
_MOST_PIXELS = 40_000  # of one picture; a larger one is an image, not data
_COLOUR_BAR = "<colorbar>"
_LETTER = 0.6  # of its size: how wide a letter is, wide ones among them
_LINE = 1.3  # of a letter's size: from line to line

Row = tuple[object, ...]


def save_figure(figure: Figure, path: Path, *, dpi: float | None = None) -> None:
    """Write `path` (a PNG), and beside it the same as SVG, and its data as `<name>-data.csv`."""
    save_picture(figure, path, dpi=dpi)
    write_data(figure, data_file(path))


def save_picture(figure: Figure, path: Path, *, dpi: float | None = None) -> None:
    """Write `path` (a PNG), and beside it the same as SVG: what is to be looked at, and is no graph.

    It is laid out before it is drawn twice; `Figure.savefig` goes through it once more for each file.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    own_dpi = figure.dpi
    figure.dpi = own_dpi if dpi is None else dpi
    _lay_out(figure)
    FigureCanvasAgg(figure).print_png(path, metadata={"Software": None})
    figure.dpi = own_dpi
    FigureCanvasSVG(figure).print_svg(path.with_suffix(".svg"), metadata={"Date": None, "Creator": "limbcli"})


def put_title(figure: Figure, text: str, *, size: float = 12.0) -> None:
    """A title above the whole figure, on as many lines as its width asks for.

    size : of the letters, points
    """
    figure.suptitle("\n".join(title_lines(text, float(figure.get_size_inches()[0]), size)), fontsize=size)


def title_lines(text: str, width_inches: float, size: float) -> list[str]:
    """The lines of a title of letters of `size` points; a letter is taken for `_LETTER` of it wide."""
    return textwrap.wrap(text, int(72.0 * width_inches / (_LETTER * size)))


@dataclass(frozen=True)
class Margins:
    """What stands round panels of known size, inches: left of all, above each, below all, between two."""

    left: float
    above: float
    below: float
    gap: float = 0.08


def panel_sheet(
    widths: Sequence[float],
    heights: Sequence[float],
    margins: Margins,
    title: str,
    *,
    title_size: float = 12.0,
) -> tuple[Figure, GridSpec]:
    """A titled figure with panels of these sizes (inches), in columns and rows.

    Where sizes are known, no layout need be sought, which takes as long as drawing.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    across = sum(widths) + (len(widths) - 1) * margins.gap
    down = sum(heights) + (len(heights) - 1) * (margins.gap + margins.above)
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
        wspace=margins.gap / float(np.mean(widths)),
        hspace=(margins.gap + margins.above) / float(np.mean(heights)),
    )  # fmt: skip
    return figure, grid


def _lay_out(figure: Figure) -> None:
    """Places for its axes; as they are laid out, they stay.

    Twice, because axes of another size have other ticks, and their labels another width.
    """
    engine = figure.get_layout_engine()
    if engine is not None:
        engine.execute(figure)
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

    kind : line, points, cell (of a mesh; its middle), bar (x, its height) or pixel; of several rows each:
        segment (its ends: error bars, intervals, outlines), span (two opposite corners: shaded ranges, bars
        that lie or do not stand on 0), band (the corners of a filled range)
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
        names = (str(axes.get_label()) or _title(axes) or k, *_axis_words(axes, figure))
        for row in (*_lines(axes), *_collections(axes), *_bars(axes), *_pixels(axes)):
            yield (*names, *row)


def _title(axes: Axes) -> str:
    """Wherever above the panel it stands."""
    every = (_plain_words(axes.get_title(at)) for at in ("left", "center", "right"))
    return next((each for each in every if each), "")


def _axis_words(axes: Axes, figure: Figure) -> tuple[str, str]:
    """Its labels, or where it shares an axis, those of a panel below or beside it, or of the whole figure."""
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


def _lines(axes: Axes) -> Iterator[Row]:
    """Without the caps of error bars, which stand at their ends."""
    from matplotlib.container import ErrorbarContainer

    error_bars = [each for each in axes.containers if isinstance(each, ErrorbarContainer)]
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


def _collections(axes: Axes) -> Iterator[Row]:
    from matplotlib.collections import LineCollection
    from matplotlib.container import ErrorbarContainer

    error_bars = [each for each in axes.containers if isinstance(each, ErrorbarContainer)]
    of: dict[Any, Any] = {bars: each for each in error_bars for bars in each.lines[2]}
    for k, each in enumerate(axes.collections):
        array = each.get_array()
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
    """Where the parts of a collection stand (n, 2), and what they are."""
    from matplotlib.collections import PathCollection, TriMesh

    if isinstance(each, PathCollection):
        return np.asarray(each.get_offsets(), dtype=float), "points"
    if isinstance(each, TriMesh):  # coloured from corner to corner
        grid = each._triangulation  # type: ignore[attr-defined]
        return np.column_stack([grid.x, grid.y]), "points"
    ends = [_corners(path) for path in each.get_paths()]
    if not ends or any(not len(end) for end in ends):
        return np.zeros((0, 2)), "cell"
    if len(ends) == 1 and each.get_array() is None:
        return ends[0], "band"
    return np.array([end.mean(axis=0) for end in ends]), "cell"


def _bars(axes: Axes) -> Iterator[Row]:
    """A bar that lies has the name that stands beside it on the axis."""
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
    """Coordinates with NaN along an axis on which they are shares of the panel (a line across it)."""
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
    return _plain_words(label)


def _plain_words(text: str) -> str:
    """A label without the signs of mathematics, on one line.

    >>> _plain_words(r"$f_\\kappa$ [–]"), _plain_words("cost 1\\\\$,\\nin all")
    ('f_κ [–]', 'cost 1$, in all')
    """
    return " ".join(text.replace(r"$f_\kappa$", "f_κ").replace(r"\$", "$").split())


def _cell(value: object) -> object:
    if value is None or (isinstance(value, float) and not np.isfinite(value)):
        return ""
    return f"{value:.7g}" if isinstance(value, float) else value
