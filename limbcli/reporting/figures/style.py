"""Common style of all drawings: unobtrusive axes, and colours that colour-blind readers can distinguish."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from typing import Any

import matplotlib
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter, NullLocator

from limbcli.model import Array

INK = "#22303c"
QUIET = "#8a97a3"
GRID = "#e3e8ec"
# The colours of Okabe and Ito's palette that print well.
BLUE, ORANGE, GREEN, VERMILION, PURPLE = "#0072b2", "#e69f00", "#009e73", "#d55e00", "#cc79a7"

MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*")  # distinguish series printed in grey
_MANY_DECADES = 200.0  # ratio of largest to smallest value above which labels at 1, 2 and 5 would touch
_NARROW = 6.0  # ratio of largest to smallest value below which labels at 1, 2 and 5 are too few

_SETTINGS: dict[Any, Any] = {
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": 9.5,
    "axes.edgecolor": QUIET,
    "axes.labelcolor": INK,
    "axes.titlesize": 10.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.titlecolor": INK,
    "axes.linewidth": 0.8,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "grid.color": GRID,
    "grid.linewidth": 0.8,
    "xtick.color": INK,
    "ytick.color": INK,
    "text.color": INK,
    "legend.frameon": False,
    "legend.fontsize": 9,
    "lines.linewidth": 1.8,
    "figure.facecolor": "white",
    "savefig.facecolor": "white",
    "svg.fonttype": "path",
    "svg.hashsalt": "limbcli",
}


def literal(text: str) -> str:
    """A user-supplied name as a literal label: dollar signs do not start mathematics, and a leading `_` does
    not hide it from a legend.

    >>> literal("cost $1$"), literal("_left"), literal("p1")
    ('cost \\\\$1\\\\$', ' _left', 'p1')
    """
    shown = text.replace("$", r"\$")
    return f" {shown}" if shown.startswith("_") else shown


@contextlib.contextmanager
def style() -> Iterator[None]:
    """Apply our settings to the drawings made in this block; the caller's are restored afterwards."""
    with matplotlib.rc_context(_SETTINGS):
        yield


def new_figure(width: float = 7.2, height: float = 3.8) -> Figure:
    """An empty figure (size in inches) with a layout that prevents overlapping labels; draw it inside
    `style()`."""
    return Figure(figsize=(width, height), dpi=150, layout="constrained")


def plain_log(axis: Axis, *, few: bool = False) -> None:
    """Plain numbers (20, not 2 × 10¹) at the ticks of a logarithmic axis; call it after everything is drawn.

    few : for a short axis, on which labels at 1, 2 and 5 would touch over more than a decade
    """
    low, high = sorted(axis.get_view_interval())
    ratio = high / low
    if ratio < _NARROW:
        axis.set_major_locator(MaxNLocator(3 if few else 5, steps=[1, 2, 5, 10]))
        axis.set_minor_locator(NullLocator())
    else:
        wide = ratio > (_MANY_DECADES / 10 if few else _MANY_DECADES)
        axis.set_major_locator(LogLocator(subs=(1.0,) if wide else (1.0, 2.0, 5.0)))
        axis.set_minor_formatter(NullFormatter())
    axis.set_major_formatter("{x:g}")


def legend_below(figure: Figure, axes: Axes, *more: Artist) -> None:
    """A legend below all panels of what one of them shows, and of more with their own labels."""
    handles = [*axes.get_legend_handles_labels()[0], *more]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles))


def log_if_wide(axes: Axes, name: str, values: Array, *, few: bool = False) -> None:
    """Make an axis ("x" or "y") logarithmic if positive values differ more than fivefold (`plain_log`)."""
    if values.min() > 0 and values.max() > 5 * values.min():
        axes.set(**{f"{name}scale": "log"})
        plain_log(axes.xaxis if name == "x" else axes.yaxis, few=few)


def facets(axes: Axes, corners: Sequence[Array] | Array, **looks: Any) -> PolyCollection:
    """Filled polygons without gaps between them, drawn as pixels, and limits of the axes that show them.

    corners : of each polygon (k, 2); looks : as of `PolyCollection`
    """
    looks = {"edgecolors": "face", "linewidths": 0.2, "rasterized": True, **looks}
    drawn = PolyCollection(list(corners), **looks)
    axes.add_collection(drawn)
    axes.autoscale_view()
    return drawn


def bare(axes: Axes) -> None:
    """Axes of a picture: equal scales, no grid."""
    axes.set_aspect("equal")
    axes.grid(False)
