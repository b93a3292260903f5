"""The diagnosis on the report page, out of the file that the stage leaves."""

from __future__ import annotations

import csv
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from limbcli.diagnosis import written_result as pictures
from limbcli.diagnosis.data.rows import SiteRows
from limbcli.diagnosis.explanations.sentences import sentences
from limbcli.diagnosis.explanations.verdict import diagnose
from limbcli.diagnosis.written_result import (
    _in_plausible_sizes,
    candidates_picture,
    diagnosis_json,
    gap_picture,
    sizes_of,
    sizes_picture,
)
from limbcli.effects import effect
from limbcli.reporting.outcome import read_outcomes
from limbcli.reporting.sections.diagnosis import diagnosis
from limbcli.results import open_stage
from tests.diagnosis import test_reduced_site as reduced


def page_of(out):
    return SimpleNamespace(out=out, outcomes=read_outcomes(out, ("p1",), case_name="case"))


@pytest.mark.slow
def test_section_shows_verdict_candidates_and_blind_spots(tmp_path):
    bench = reduced.bench(reduced.levels(np.random.default_rng(7)))
    found = diagnose(bench)
    with open_stage(tmp_path, "diagnose", subject="S1", site="p1") as writer:
        writer.data.update({**diagnosis_json(found, bench.site, bench), "sentences": sentences(found)})
        gap_picture(found, [bench.site], writer.file("gap", "gap.png"))
        candidates_picture(found, writer.file("candidates", "candidates.png"))
        sizes_picture(found, sizes_of(bench, bench.site), writer.file("sizes", "sizes.png"))
    shown = diagnosis(page_of(tmp_path), SimpleNamespace(name="p1"))
    assert shown.mood == "fine"
    assert shown.answer.startswith("ADEQUATE")
    names = {row[0].text for row in shown.tables[0].rows}
    assert {"force-zero", "poroelasticity"} <= names
    explanations, shrunk, blind, sizes_table, common_table = shown.more
    assert explanations.rows[0][0].text == "nothing is missing"
    assert len(explanations.rows) == len(found.confidence_set)
    assert len(shrunk.rows) == len(found.shrink)
    assert {row[0].text for row in blind.rows} == {each.name for each in found.blind_spots}
    probabilities = {row[0].text: row[2].text for row in shown.tables[0].rows}
    assert probabilities["force-zero"] == f"{found.effects['force-zero']:.3f}"
    sizes = {(row[0].text, row[1].text): row[2].text for row in sizes_table.rows}
    assert float(sizes["force-zero", "f0_n"]) < 0.0
    assert "open" in sizes.values()
    common = {row[0].text: (float(row[1].text), float(row[2].text)) for row in common_table.rows}
    assert 0.0 < common["gain of all speeds"][1] < 1.0
    assert len(shown.pictures) == 3


@pytest.mark.parametrize(
    ("effect_name", "parameter", "ends", "shown"),
    [("force-zero", 0, (-0.25, 0.75), (-0.25, 0.75)), ("viscoelasticity", 0, (-0.6, 0.6), (0.0, 2.0)),
     ("thickness", 0, (-2.0, -1.3), (-2.0, -2.0)), ("depth-gain", 0, (-np.inf, np.inf), (-7 / 3, 5 / 3))],
)  # fmt: skip
def test_sizes_are_drawn_within_what_is_looked_for(effect_name, parameter, ends, shown):
    p = effect(effect_name).sizes[parameter]
    assert _in_plausible_sizes(p, ends) == pytest.approx(shown), (p.null, p.typical, p.low, p.high)


def test_a_bar_of_a_detectable_size_that_is_cut_is_told_by_its_axis(tmp_path):
    spot = SimpleNamespace(name="tilt", detectable_times_typical=40.0)
    found = SimpleNamespace(effects={"tilt": 0.97, "force-zero": 0.02}, blind_spots=[spot])
    candidates_picture(found, tmp_path / "candidates.png")
    with (tmp_path / "candidates-data.csv").open() as stream:
        axis = {row["x_axis"]: float(row["x"]) for row in csv.DictReader(stream)
                if row["series"] == "tilt"}  # fmt: skip
    (probability,) = [value for name, value in axis.items() if "probability" in name]
    ((cut, size),) = [each for each in axis.items() if "plausible sizes" in each[0]]
    assert (probability, size) == (0.97, 10.0)
    assert "10: or more" in cut


def test_nothing_is_shown_where_nothing_was_diagnosed(tmp_path):
    assert diagnosis(page_of(tmp_path), SimpleNamespace(name="p1")) is None


CHANNELS = ("force", "swe", "map", "travel", "layer", "hold")


@pytest.mark.slow
def test_words_of_a_gap_of_many_channels_and_sites_can_be_read_in_print(tmp_path, monkeypatch):
    """Two sites with six channels on a page 17 cm wide; no letter smaller than 6 points, none cut off."""
    kept, n = [], 3 * len(CHANNELS)
    monkeypatch.setattr(pictures, "slices", lambda s: [slice(n * k, n * (k + 1)) for k in range(len(s))])
    monkeypatch.setattr(pictures, "save_figure", lambda figure, *_, **__: kept.append(figure))
    rows = SiteRows.together([SiteRows.of(each, np.arange(3)) for each in CHANNELS])
    data = SimpleNamespace(y=np.ones(n), deviation=np.ones(n))
    sites = [
        SimpleNamespace(name=f"medial proximal am Köpfchen {k}", rows=rows, data=data,
                        protocol=SimpleNamespace(depth=np.arange(3.0)))
        for k in range(2)
    ]  # fmt: skip
    last = SimpleNamespace(explanation=())
    found = SimpleNamespace(base=SimpleNamespace(prediction=np.zeros(2 * n)), shrink=(last,), explanations=())
    gap_picture(found, sites, tmp_path / "gap.png")
    (figure,) = kept
    FigureCanvasAgg(figure).draw()
    shrunk = min(1.0, 6.7 / figure.get_figwidth())
    words = [text for axes in figure.axes for text in (axes.title, axes.xaxis.label, axes.yaxis.label)]
    words = [each for each in words if each.get_text()]
    assert len([each for each in words if "Köpfchen" in each.get_text() or "medial" in each.get_text()]) == 12
    for each in words:
        assert shrunk * each.get_fontsize() >= 6.0
        box = each.get_window_extent()
        assert 0 <= box.x0 < box.x1 <= figure.bbox.x1
