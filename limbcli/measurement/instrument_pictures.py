"""Pictures of what was read from the instruments' files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from limbcli.drawing import save_figure, save_picture
from limbcli.measurement.bmode import BoneLine
from limbcli.measurement.elastography import SweMap
from limbcli.measurement.holds import Hold
from limbcli.measurement.pennation import PennationReading
from limbcli.measurement.trace import Trace
from limbcli.measurement.ultrasound_image import UltrasoundImage

_COLUMNS = 5
_BOXES = "pixels read from the overlays (line: median; box: the middle half)"


def draw_holds(trace: Trace, holds: Sequence[Hold], path: Path) -> None:
    """Draw the record with its holds shaded; those with ongoing creep are highlighted."""
    figure = Figure(figsize=(9, 3.6), layout="constrained")
    axes = figure.subplots()
    axes.plot(trace.time, trace.force, color="0.6", lw=0.6)
    for k, hold in enumerate(holds):
        colour = "tab:orange" if hold.creeping else "tab:blue"
        axes.axvspan(hold.start_s, hold.end_s, color=colour, alpha=0.15)
        axes.plot([hold.start_s, hold.end_s], [hold.force, hold.force], color=colour, lw=1.5)
        axes.annotate(str(k), (hold.start_s, hold.force), xytext=(2, 4), textcoords="offset points", size=8)
    axes.set(xlabel="time [s]", ylabel="force [N]", title="holds found (orange: creep still going on)")
    low, high = np.nanpercentile(trace.force, (0.1, 99.9))  # spikes do not determine the range
    axes.set_ylim(low - 0.1 * (high - low) - 0.1, high + 0.1 * (high - low) + 0.1)
    save_figure(figure, path, dpi=130)


def draw_bone_lines(
    images: Sequence[UltrasoundImage], lines: Sequence[BoneLine], path: Path, *,
    borders: Mapping[str, Sequence[BoneLine]] = MappingProxyType({}),
) -> None:  # fmt: skip
    """Draw every level's image with the detected bone line, and the lower interfaces of layers by name."""
    rows = -(-len(images) // _COLUMNS)
    columns = min(len(images), _COLUMNS)
    figure = Figure(figsize=(2.4 * columns + 0.4, 2.7 * rows), layout="constrained")
    for k, axes in enumerate(figure.subplots(rows, columns, squeeze=False).ravel()):
        if k >= len(images):
            axes.set_axis_off()
            continue
        line = lines[k]
        _show(axes, images[k])
        axes.plot([-5, 5], [line.distance, line.distance], color="tab:orange", lw=1.2)
        for name, found in borders.items():
            at = found[k].distance
            axes.plot([-5, 5], [at, at], color="tab:cyan", lw=1.0)
            axes.text(5.3, at, name, color="tab:cyan", size=6, va="center", clip_on=True)
        axes.set_title(f"level {k}: {line.distance:.2f} mm (SD {line.sd:.2f})", size=8)
        axes.set_xticks([])
        axes.tick_params(labelsize=7)
        if k % columns == 0:
            axes.set_ylabel("depth [mm]", size=8)
    save_picture(figure, path, dpi=130)


def draw_pennation(image: UltrasoundImage, reading: PennationReading, path: Path) -> None:
    """Draw the image with the direction of each tile, and their mean."""
    figure = Figure(layout="constrained")
    axes = figure.subplots()
    width, height = _show(axes, image)
    figure.set_size_inches(6.5, 6.5 * height / width + 0.8)
    angle = np.radians(reading.tile_deg)
    dx, dy = 1.8 * np.cos(angle), 1.8 * np.sin(angle)
    axes.plot(
        [reading.lateral - dx, reading.lateral + dx], [reading.depth - dy, reading.depth + dy],
        color="tab:orange", lw=1.4,
    )  # fmt: skip
    axes.set(
        xlabel="lateral [mm]", ylabel="depth [mm]",
        title=f"fibres at {reading.angle_deg:.1f} deg (deviation {reading.deviation_deg:.1f}, "
        f"spread {reading.spread_deg:.1f})",
    )  # fmt: skip
    save_picture(figure, path, dpi=130)


def _show(axes: Axes, image: UltrasoundImage) -> tuple[float, float]:
    """Draw an image's main region, centred below the probe; returns its width and height, mm."""
    region = image.main_region()
    width = (region.right - region.left + 1) * region.mm_per_pixel_x
    height = (region.bottom - region.top + 1) * region.mm_per_pixel_y
    grey = image.grey[region.top : region.bottom + 1, region.left : region.right + 1]
    axes.imshow(grey, cmap="gray", extent=(-width / 2, width / 2, height, 0), aspect="equal")
    return width, height


def draw_speeds(maps: Sequence[SweMap], path: Path) -> None:
    """Box plot of the speeds of every level."""
    figure = Figure(figsize=(7, 3.6), layout="constrained")
    axes = figure.subplots()
    axes.boxplot([each.speed_m_per_s for each in maps], positions=np.arange(len(maps)), showfliers=False)
    axes.set(xlabel="force level [–]", ylabel="shear-wave speed [m/s]", title=_BOXES)
    save_figure(figure, path, dpi=130)
