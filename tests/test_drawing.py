"""What a figure shows can be read back from the table beside it."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

from limbcli.drawing import COLUMNS, Margins, data_file, figure_data, panel_sheet, put_title, save_figure
from limbcli.reporting.figures.style import new_figure, style

pytestmark = pytest.mark.drawn


def read(path: Path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


def test_lines_points_cells_bars_and_pixels_come_back(tmp_path, rng):
    figure = Figure()
    left, right = figure.subplots(1, 2)
    x = np.linspace(0, 3, 7)
    left.plot(x, x**2, label="model")
    left.set(title="curves", xlabel="depth [mm]", ylabel="force [N]")
    shown = left.scatter([1.0, 2.0], [3.0, 4.0], c=[5.0, 6.0], label="measured")
    figure.colorbar(shown, ax=left)
    squares = [[(0, 0), (2, 0), (2, 2), (0, 2)], [(2, 0), (4, 0), (4, 2), (2, 2)]]
    right.add_collection(PolyCollection(squares, array=np.array([7.0, 8.0])))
    right.bar([10.0], [2.5])
    image = rng.random((2, 3))
    right.imshow(image, extent=(0, 3, 0, 2), origin="lower")
    save_figure(figure, tmp_path / "a.png")

    rows = read(data_file(tmp_path / "a.png"))
    assert list(rows[0]) == list(COLUMNS)
    line = [row for row in rows if row["kind"] == "line"]
    np.testing.assert_allclose([[float(r["x"]), float(r["y"])] for r in line], np.c_[x, x**2], rtol=1e-6)
    assert {(r["panel"], r["x_axis"], r["series"]) for r in line} == {("curves", "depth [mm]", "model")}
    points = [[float(row[k]) for k in ("x", "y", "value")] for row in rows if row["kind"] == "points"]
    assert points == [[1, 3, 5], [2, 4, 6]]
    cells = [[float(row[k]) for k in ("x", "y", "value")] for row in rows if row["kind"] == "cell"]
    assert cells == [[1, 1, 7], [3, 1, 8]]
    assert [float(row["y"]) for row in rows if row["kind"] == "bar"] == [2.5]
    pixels = {(float(r["x"]), float(r["y"])): float(r["value"]) for r in rows if r["kind"] == "pixel"}
    assert pixels[2.5, 1.5] == float(f"{image[1, 2]:.7g}")
    assert len({row["panel"] for row in rows}) == 2, "a colour bar is no panel"


def test_picture_and_drawing_lie_beside_it_and_are_the_same_each_time(tmp_path):
    for name in ("a", "b"):
        figure = Figure()
        figure.subplots().plot([0, 1])
        save_figure(figure, tmp_path / f"{name}.png")
    assert (tmp_path / "a.png").read_bytes()[:4] == b"\x89PNG"
    assert (tmp_path / "a.svg").read_text().startswith("<?xml")
    assert read(tmp_path / "a-data.csv") == read(tmp_path / "b-data.csv")


def test_what_is_no_number_is_left_empty(tmp_path):
    figure = Figure()
    figure.subplots().plot([0.0, 1.0], [np.nan, 2.0])
    assert len(list(figure_data(figure))) == 2
    save_figure(figure, tmp_path / "a.png")
    assert [row["y"] for row in read(tmp_path / "a-data.csv")] == ["", "2"]


def test_intervals_shaded_ranges_and_names_come_back():
    figure = Figure()
    left, right = figure.subplots(1, 2, sharey=True)
    left.set_title("force", loc="left")
    left.set(xlabel="depth [mm]", ylabel="force [N]")
    left.errorbar([1.0, 2.0], [3.0, 4.0], xerr=0.5, yerr=0.25, capsize=2, label="measured")
    left.fill_between([0.0, 1.0], [0.0, 0.0], [1.0, 2.0], label="fat, predicted")
    left.axvline(1.5, label="the fit")
    right.axvspan(0.5, 2.5, label="95 %")
    right.barh([0.0, 1.0], [2.0, 3.0], left=[-1.0, 0.0])
    right.set_yticks([0, 1], ["tilt", "friction"])
    rows = list(figure_data(figure))
    assert {row[:3] for row in rows} >= {("force", "depth [mm]", "force [N]"), (2, "", "force [N]")}
    kinds = {kind: [row[4:8] for row in rows if row[3] == kind] for kind in {row[3] for row in rows}}
    assert [row for row in kinds["line"] if row[0] == "measured"] == [
        ("measured", 0, 1.0, 3.0), ("measured", 1, 2.0, 4.0),
    ]  # fmt: skip
    ends = {row[2:] for row in kinds["segment"] if row[0] == "measured"}
    assert ends == {(0.5, 3), (1.5, 3), (1.5, 4), (2.5, 4), (1, 2.75), (1, 3.25), (2, 3.75), (2, 4.25)}
    assert {("fat, predicted", 0.0, 0.0), ("fat, predicted", 1.0, 2.0)} <= {
        (name, x, y) for name, _, x, y in kinds["band"]
    }
    assert [(x, np.isnan(y)) for name, _, x, y in kinds["line"] if name == "the fit"] == [(1.5, True)] * 2
    spans = {name: [] for name, *_ in kinds["span"]}
    for name, _, x, _ in kinds["span"]:
        spans[name].append(x)
    assert spans == {"95 %": [0.5, 2.5], "tilt": [-1.0, 1.0], "friction": [0.0, 3.0]}
    assert {row[0] for row in kinds["line"]} == {"measured", "the fit"}, "caps are no data"


def test_a_field_from_corner_to_corner_keeps_its_values():
    figure = Figure()
    axes = figure.subplots()
    axes.tripcolor([0.0, 1.0, 0.0], [0.0, 0.0, 2.0], np.array([5.0, 6.0, 7.0]), shading="gouraud")
    assert [row[6:] for row in figure_data(figure)] == [(0, 0, 5), (1, 0, 6), (0, 2, 7)]


@pytest.mark.parametrize("height", [3.5, 3.75, 4.0])
def test_labels_of_a_saved_picture_are_on_it(tmp_path, height):
    """A legend below takes the axes' height, with it ticks, and another width of their labels."""
    with style():
        figure = new_figure(7.4, height)
        left, right = figure.subplots(1, 2, sharey=True)
        for axes in (left, right):
            axes.plot([0, 10], [0, 3.9], label="one\ntwo\nthree\nfour")
            axes.set(ylim=(0, 4.2), ylabel="shear-wave speed [m/s]")
            axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.2))
        save_figure(figure, tmp_path / "a.png")
    assert left.yaxis.label.get_window_extent().x0 >= 0


@pytest.mark.parametrize(("width", "size"), [(6.0, 12.0), (10.0, 10.0), (17.0, 12.0)])
def test_a_long_title_stays_on_the_picture(width, size):
    figure = Figure(figsize=(width, 3.0))
    put_title(figure, "Mean of 12 MEASUREMENTS at site proximal-b, quality: good; " * 6, size=size)
    title = figure._suptitle.get_window_extent(FigureCanvasAgg(figure).get_renderer())
    assert figure.bbox.x0 <= title.x0
    assert title.x1 <= figure.bbox.x1


def test_panels_of_a_sheet_have_the_sizes_asked_for():
    widths, heights = [1.0, 2.0, 1.5], [2.5, 0.5]
    figure, grid = panel_sheet(widths, heights, Margins(left=0.4, above=0.3, below=0.8), "words " * 40)
    FigureCanvasAgg(figure)
    for i, height in enumerate(heights):
        for j, width in enumerate(widths):
            box = figure.add_subplot(grid[i, j]).get_window_extent()
            assert np.allclose(np.array([box.width, box.height]) / figure.dpi, [width, height])
    title = figure._suptitle.get_window_extent()
    assert title.y0 > figure.axes[0].get_window_extent().y1
    assert title.y1 < figure.bbox.y1
