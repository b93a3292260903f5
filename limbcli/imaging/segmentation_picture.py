"""Contact sheet: outlines over slices, to inspect the whole segmentation at a glance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray
from skimage.measure import find_contours

from limbcli.drawing import Margins, panel_sheet, save_picture
from limbcli.imaging.segmentation import MARKER, Segmentation
from limbcli.imaging.signed_distance import box_around
from limbcli.imaging.volume import Volume
from limbcli.model import Array
from limbcli.model.patient_frame import side_of

_COLUMNS, _ROWS = 5, 4
_SKIN, _BONES, _MARKER = "#ffd400", ("#ff3b30", "#28c8ff", "#7cfc00", "#ff8cff"), "#ff00ff"
_FAT = "#58d68d"
_PANEL_INCHES = 1.85
_MARGINS = Margins(left=0.5, above=0.17, below=0.75)
_OBLIQUE_MM = 1.0  # largest error of a coordinate read from the axes of a slice oblique to the patient


@dataclass(frozen=True)
class SliceAxis:
    """How an axis of a slice is shown: `first + sign * mm`, with mm from the image's first voxel."""

    first: float
    sign: float
    label: str

    def __call__(self, mm: Array) -> Array:
        return self.first + self.sign * mm

    def ends(self, low: float, high: float) -> tuple[float, float]:
        return self.first + self.sign * low, self.first + self.sign * high


def slice_axes(image: Volume, window: Sequence[slice]) -> tuple[SliceAxis, SliceAxis]:
    """The axes along i and j of all slices: patient coordinates (LPS) if the slices are square to the
    patient, so that a position can be read from them; else mm within the slice, and the label says so.

    window : the shown ranges of i and j, and that of all slices
    """
    spans = np.array([each.stop - each.start for each in window]) * image.spacing
    middle = np.array([[0.5 * (each.start + each.stop - 1) for each in window]])
    directions = image.affine[:3, :3] / image.spacing

    def along(n: int) -> SliceAxis | None:
        axis = int(np.argmax(np.abs(directions[:, n])))
        sign = float(np.sign(directions[axis, n]))
        lost = np.abs(directions[axis] - sign * (np.arange(3) == n))
        if float(0.5 * lost @ spans) > _OBLIQUE_MM:
            return None
        first = image.to_patient(middle)[0, axis] - sign * middle[0, n] * image.spacing[n]
        return SliceAxis(float(first), sign, f"{'xyz'[axis]} (LPS), mm")

    across, down = along(0), along(1)
    if across is None or down is None:
        return SliceAxis(0.0, 1.0, "mm along i (not LPS)"), SliceAxis(0.0, 1.0, "mm along j (not LPS)")
    return across, down


def contact_sheet(
    path: Path, image: Volume, found: Segmentation, names: Sequence[str], *, title: str
) -> None:
    """Draw twenty slices from distal to proximal with skin, bones and markers outlined.

    image : the grey values (or the labels themselves if there is no image), any orientation
    names : of the bones
    """
    grey, _, _ = image.along_limb()
    labels, _, _ = found.labels.along_limb()
    filled = np.flatnonzero((labels.values > 0).any(axis=(0, 1)))
    chosen = np.unique(np.linspace(filled[0], filled[-1], _COLUMNS * _ROWS).round().astype(int))
    rows = int(np.ceil(len(chosen) / _COLUMNS))
    window = box_around(np.any(labels.values > 0, axis=2), np.ceil(6.0 / grey.spacing[:2]))
    across, down = slice_axes(grey, (*window, slice(int(chosen[0]), int(chosen[-1]) + 1)))
    height = (window[1].stop - window[1].start) * grey.spacing[1]
    width = (window[0].stop - window[0].start) * grey.spacing[0]
    widths, heights = [_PANEL_INCHES] * _COLUMNS, [_PANEL_INCHES * height / width] * rows
    figure, grid = panel_sheet(widths, heights, _MARGINS, title, title_size=10.0)
    top = float(np.percentile(grey.values[labels.values > 0], 99.5))
    markers = labels.values == MARKER
    for number, k in enumerate(chosen, 1):
        axes = figure.add_subplot(grid[divmod(number - 1, _COLUMNS)])
        extent = _extent(window, grey.spacing, across, down)
        section = np.clip(grey.values[*window, k].T / max(top, 1e-9), 0, 1) ** 0.7
        axes.imshow(section, cmap="gray", vmin=0, vmax=1, extent=extent, interpolation="bilinear")
        _outlines(axes, found, markers, grey, int(k), across, down)
        axes.set_xlim(extent[0], extent[1])
        axes.set_ylim(extent[2], extent[3])
        _label_sides(axes, grey)
        height_mm = grey.to_patient(np.array([[*(n / 2 for n in grey.shape[:2]), k]]))[0, 2]
        axes.set_title(f"slice {k + 1} of {grey.shape[2]}, z = {height_mm:.0f} mm", fontsize=8)
        is_lowest, is_first = number > len(chosen) - _COLUMNS, number % _COLUMNS == 1
        axes.tick_params(labelsize=6)
        axes.set_xlabel(across.label, fontsize=7)
        axes.set_ylabel(down.label, fontsize=7)
        axes.xaxis.set_visible(is_lowest)
        axes.yaxis.set_visible(is_first)
    lines = [Line2D([], [], color=colour, label=label) for label, colour in _outlined(found, names, markers)]
    figure.legend(handles=lines, loc="lower center", ncols=len(lines), facecolor="0.3", labelcolor="white")
    save_picture(figure, path, dpi=130)


def _outlined(found: Segmentation, names: Sequence[str], markers: NDArray[np.bool_]) -> list[tuple[str, str]]:
    """The outlined structures and their colours."""
    entries = [("skin", _SKIN)]
    entries += [(name, _BONES[k % len(_BONES)]) for k, name in enumerate(names)]
    entries += [("fat", _FAT)] if found.fat is not None else []
    return entries + ([("marker", _MARKER)] if markers.any() else [])


def _label_sides(axes: Axes, grey: Volume) -> None:
    """Label the panel's edges with the first letter of the patient's side: L for left and so on."""
    across, down = grey.affine[:3, 0], grey.affine[:3, 1]
    places = ((across, 0.98, 0.5), (-across, 0.02, 0.5), (down, 0.5, 0.02), (-down, 0.5, 0.98))
    for direction, x, y in places:
        letters = "".join(word[0].upper() for word in side_of(direction).split(" and "))
        axes.text(
            x, y, letters, transform=axes.transAxes, color="white", fontsize=8, fontweight="bold",
            ha={0.98: "right", 0.02: "left"}.get(x, "center"),
            va={0.98: "top", 0.02: "bottom"}.get(y, "center"),
            path_effects=[withStroke(linewidth=1.5, foreground="black")],
        )  # fmt: skip


def _extent(
    window: tuple[slice, ...], spacing: Array, across: SliceAxis, down: SliceAxis
) -> tuple[float, float, float, float]:
    i, j = window[0], window[1]
    return (
        *across.ends((i.start - 0.5) * spacing[0], (i.stop - 0.5) * spacing[0]),
        *down.ends((j.stop - 0.5) * spacing[1], (j.start - 0.5) * spacing[1]),
    )


def _outlines(
    axes: Axes, found: Segmentation, markers: NDArray[np.bool_], grey: Volume, k: int, across: SliceAxis,
    down: SliceAxis,
) -> None:  # fmt: skip
    """Draw contours of the working masks, in the coordinates of the shown axes."""
    masks = [] if found.fat is None else [(found.fat, _FAT, 0.4)]
    masks += [(found.skin, _SKIN, 0.9)]
    masks += [(bone, _BONES[number % len(_BONES)], 0.9) for number, bone in enumerate(found.bones)]
    masks += [(grey.with_values(markers), _MARKER, 0.9)]
    lines = [(each, colour, width) for mask, colour, width in masks for each in _contours(mask, grey, k)]
    if lines:
        in_mm, colours, widths = zip(*lines, strict=True)
        drawn = [np.column_stack([across(each[:, 0]), down(each[:, 1])]) for each in in_mm]
        axes.add_collection(LineCollection(drawn, colors=colours, linewidths=widths), autolim=False)


def _contours(mask: Volume, grey: Volume, k: int) -> list[Array]:
    """Contour lines (n, 2) of a mask in slice k, mm along i and j of the image."""
    section = mask.values[:, :, k]
    if not section.any():
        return []
    first = grey.to_voxel(mask.affine[:3, 3][None])[0, :2]
    ratio = mask.spacing[:2] / grey.spacing[:2]
    return [(first + each * ratio) * grey.spacing[:2] for each in find_contours(section.astype(float), 0.5)]
