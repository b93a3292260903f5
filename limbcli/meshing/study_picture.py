"""Picture of a mesh refinement study."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from limbcli.drawing import put_title, save_figure
from limbcli.meshing.mesh_extrapolation import Extrapolation


def study_picture(
    path: Path, *, sizes: list[tuple[float, float]], margins: list[tuple[float, float]],
    used: tuple[float, float], extrapolation: Extrapolation, depth: float, title: str,
) -> None:  # fmt: skip
    """Plot the force (N) at full depth against edge length and against the margin beyond the probe.

    sizes, margins : (mm, N) pairs; used : (size, margin) of the model itself
    """
    figure = Figure(figsize=(11, 4.4), layout="constrained")
    left, right = figure.subplots(1, 2)
    _curve(left, sizes, used[0], "edge length under the probe [mm]", depth, (extrapolation.limit,))
    left.axhline(extrapolation.limit, color="#777777", linestyle="--", linewidth=1)
    how = "assumed" if extrapolation.order_is_assumed else "seen"
    left.set_title(
        f"dashed: extrapolated to 0 ({extrapolation.limit:.3g} N, order {extrapolation.order:.1f} {how})"
    )
    left.set_xlim(left=0)
    _curve(right, margins, used[1], "tissue kept beyond the probe face [mm]", depth)
    right.set_title("where it is flat, the cut is far enough away")
    put_title(figure, title)
    save_figure(figure, path, dpi=120)


def _curve(
    axes: Any, pairs: list[tuple[float, float]], used: float, label: str, depth: float,
    others: tuple[float, ...] = (0.0,),
) -> None:  # fmt: skip
    """others : further forces (N) that the axis must include"""
    x, force = zip(*sorted(pairs), strict=True)
    axes.plot(x, force, "o-", color="#1f4e79")
    mine = [(a, f) for a, f in pairs if a == used]
    axes.plot(*zip(*mine, strict=True), "o", color="#c8502d", markersize=9, label="the model")
    axes.set(xlabel=label, ylabel=f"force at {depth:.2f} mm [N]", ylim=(0, 1.12 * max(*force, *others)))
    axes.legend(frameon=False)
