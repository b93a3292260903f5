"""The report page: whole, honest about gaps, and self-contained."""

from __future__ import annotations

import base64
import csv
import json
import re
from dataclasses import replace
from html import escape
from html.parser import HTMLParser
from itertools import pairwise
from pathlib import Path

import meshio
import numpy as np
import pytest
from matplotlib.figure import Figure

from limbcli.case import Case
from limbcli.errors import CaseError, ToolError
from limbcli.fitting.laws import LOCKING
from limbcli.inference.agreement import chi_square_agreement
from limbcli.reporting.fit_view import read_fit_view
from limbcli.reporting.numbers import significant
from limbcli.reporting.page import render
from limbcli.reporting.sections.convergence import profiles
from limbcli.reporting.sections.joint_fit import joint, laws
from limbcli.reporting.sections.next_steps import (
    SourcedWarning,
    WarningKind,
    changes_of,
    next_steps,
    warning_groups,
)
from limbcli.reporting.sections.overview import overview
from limbcli.reporting.sections.parameters import parameters
from limbcli.reporting.sections.unloaded_state import states
from limbcli.results import open_stage, read_result, sealed
from limbcli.stages.batch import batch
from limbcli.stages.batching.outcome import keep_error, report_failure
from limbcli.stages.report import report
from limbcli.stages.report_pages.material import gather
from limbcli.version import __version__
from tests.stages import test_report_state
from tests.stages.test_mesh import prism

CASE_TOML = """\
format = 1
[subject]
id = "S1"
limb = "left"
[imaging]
skin = "skin.ply"
bones = ["tibia.ply"]
[probe]
name = "GE 9L"
length_mm = 53.0
width_mm = 14.0
edge_radius_mm = 3.0
"""
SITE_TOML = """\
[[site]]
name = "{name}"
position_mm = [12.0, 48.5, -60.0]
long_axis = "transverse"
levels = "{name}.csv"
[site.noise]
source = "spec"
"""
DEPTH = np.array([0.0, 2.0, 4.0, 5.5, 7.0, 8.2, 9.1, 10.0])
FORCE = 1.1 * DEPTH + 0.12 * DEPTH**2
SPEED = 2.25 + 0.055 * FORCE


def make_case(folder: Path, *, sites: tuple[str, ...] = ("p1",)) -> Case:
    folder.mkdir(parents=True, exist_ok=True)
    tables = "".join(SITE_TOML.format(name=name) for name in sites)
    (folder / "case.toml").write_text(CASE_TOML + tables)
    for name in ("skin.ply", "tibia.ply"):
        (folder / name).write_text("ply\n")
    rows = ["force_n,depth_mm,swe_mean_m_per_s,swe_sd_m_per_s"]
    rows += [f"{f:.4f},{d},{v:.4f},0.2" for f, d, v in zip(FORCE, DEPTH, SPEED, strict=True)]
    for name in sites:
        (folder / f"{name}.csv").write_text("\n".join(rows) + "\n")
    return Case.open(folder)


def small_png(path: Path) -> None:
    figure = Figure(figsize=(2, 1))
    figure.subplots().plot([0, 1])
    figure.savefig(path)


def add_segment(out: Path) -> None:
    with open_stage(out, "segment", subject="S1") as writer:
        small_png(writer.file("contact_sheet", "contact-sheet.png"))
        writer.data["markers"] = [{"number": 1, "position_mm": [1.0, 2.0, 3.0]}]
        writer.data["volumes_ml"] = {"skin": 1234.5, "bone_tibia": 98.7}
        writer.summary.append("2 bones")
        writer.warnings.append("the fibula is missing <in> two slices")


def add_mesh(out: Path, site: str) -> None:
    with open_stage(out, "mesh", subject="S1", site=site) as writer:
        small_png(writer.file("picture", "mesh.png"))
        writer.data.update(n_nodes=6200, element="tet10", edge_mean_mm=2.6)


def step_data(*, m: float, m_free: bool, r2: float, rmse_n: float) -> dict:
    words = "f_kappa is not identifiable from these data: the data exclude only values below 52 (95 %)."
    parameters = {
        "c_kpa": {"value": 10.13, "low": 9.1, "high": 11.2, "flag": "fixed", "words": "c is held fixed"},
        "f_kappa": {"value": 80.0, "low": 52.0, "high": None, "flag": "weak", "words": words},
    }
    if m_free:
        parameters["m"] = {
            "value": m,
            "low": 3.7,
            "high": 4.5,
            "flag": "identified",
            "words": "m is identified",
        }
    history = [{"cost_n2": 50.0 * 0.2**k, "f_kappa": 100.0 - 4 * k} for k in range(5)]
    return {
        "c_kpa": 10.13, "m": m, "f_kappa": 80.0, "kappa_kpa": 810.4, "r2": r2, "rmse_n": rmse_n,
        "n_iterations": 4, "n_solves": 9, "seconds": 33.2, "reason": "the cost settled",
        "parameters": parameters, "history": history,
    }  # fmt: skip


def add_fit(
    out: Path,
    site: str,
    *,
    element: str = "tet10",
    noise: str = "repeats",
    scale: float = 1.0,
    c_kpa: float | None = None,
    state: str = "good",
    words: str = "the force agrees: RMSE 0.21 N",
) -> None:
    with open_stage(out, "fit", subject="S1", site=site) as writer:
        steps = {
            "mooney-rivlin": step_data(m=2.0, m_free=False, r2=0.981, rmse_n=0.83),
            "ogden": step_data(m=4.1, m_free=True, r2=0.99871, rmse_n=0.2134),
        }
        writer.data.update(
            element=element, solver="reference", solver_version="0.1.0", linear_solver="pardiso",
            c_source="2 mu from SWE at level 0 (2.250 m/s)", steps=steps, noise={"source": noise},
            noise_scale=scale, asked={} if c_kpa is None else {"c_kpa": c_kpa},
            agreement={"state": state, "force": {"state": state, "words": words, "rms": 0.216}},
        )  # fmt: skip
        rows = ["depth_mm,measured_n,start_n,mooney-rivlin_n,ogden_n"]
        rows += [
            f"{d},{f:.6g},{4 * f:.6g},{0.95 * f:.6g},{f + 0.02:.6g}"
            for d, f in zip(DEPTH, FORCE, strict=True)
        ]
        writer.file("curves", "curves.csv").write_text("\n".join(rows) + "\n")
        small_png(writer.file("profiles", "profiles.png"))
        writer.warnings.append("f_kappa trades off <with> c")
        if element == "tet4":
            writer.warnings.append(LOCKING)


class Page(HTMLParser):
    """Tags in order, checked for balance; text; attributes."""

    VOID = frozenset({"meta", "img", "link", "br", "hr", "input"})

    def __init__(self, html: str):
        super().__init__()
        self.open: list[str] = []
        self.tags: list[tuple[str, dict[str, str]]] = []
        self.words: list[str] = []
        self.tables: list[list[list[str]]] = []
        self.feed(html)
        self.close()
        assert not self.open

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag not in self.VOID:
            self.open.append(tag)
        if tag == "table":
            self.tables.append([])
        if tag == "tr":
            self.tables[-1].append([])
        if tag in ("td", "th"):
            self.tables[-1][-1].append("")

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if not self.open or self.open[-1] in ("style", "script"):
            return
        self.words.append(data)
        if "tr" in self.open and self.tables[-1][-1]:
            self.tables[-1][-1][-1] += data

    @property
    def text(self) -> str:
        return re.sub(r"\s+", " ", "".join(self.words))

    def all(self, tag: str) -> list[dict[str, str]]:
        return [attrs for name, attrs in self.tags if name == tag]

    def table(self, word: str) -> list[list[str]]:
        """The first table that holds a word, cells without surplus space."""
        clean = [[[" ".join(cell.split()) for cell in row] for row in table] for table in self.tables]
        return next(table for table in clean if any(word in cell for row in table for cell in row))


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> tuple[Path, Page]:
    """A report of a subject with one finished site, one half done and one failed."""
    base = tmp_path_factory.mktemp("report")
    case, out = make_case(base / "case", sites=("p1", "p2", "p3")), base / "out"
    add_segment(out)
    for site in ("p1", "p2"):
        add_mesh(out, site)
    write_run_of(out, "p1")
    add_fit(out, "p1")
    fail(out, "mesh", "p3")
    result = report(case, out=out)
    return out, Page(result.path("page").read_text(encoding="utf-8"))


def write_run_of(out: Path, site: str) -> None:
    with open_stage(out, "run", subject="S1", site=site) as writer:
        test_report_state.write_run(writer.work, test_report_state.box_model())
        writer.data.update(solver="febio", solver_version="4.11.0")


def fail(out: Path, stage: str, site: str | None) -> None:
    folder = out / stage / site if site else out / stage
    folder.mkdir(parents=True, exist_ok=True)
    note = {
        "error": "MeshError", "what": "the probe reaches beyond the skin", "where": f"site {site}",
        "fix": "move position_mm & try again",
    }  # fmt: skip
    (folder / "error.json").write_text(json.dumps(note))


def test_a_site_that_is_still_to_be_measured_has_a_page(tmp_path: Path):
    case = make_case(tmp_path / "case")
    (case.folder / "p1.csv").unlink()
    assert "levels p1" not in report(case, out=tmp_path / "out").provenance["inputs_sha256"]


def test_page_needs_nothing_but_itself(whole):
    out, page = whole
    for name, attrs in page.tags:
        for key in ("src", "href", "srcset", "action"):
            if key in attrs:
                assert attrs[key].startswith(("data:", "#")), (name, attrs[key])
    assert not page.all("link")
    html = (out / "report" / "report.html").read_text(encoding="utf-8")
    for script in re.findall(r"<script[^>]*>(.*?)</script>", html, re.DOTALL):
        assert not re.search(r"https?:|\bfetch\b|XMLHttp|\bimport\b|WebSocket|\beval\b", script)


def test_the_model_can_be_turned_and_its_still_picture_stays_where_it_cannot(whole):
    out, page = whole
    html = (out / "report" / "report.html").read_text(encoding="utf-8")
    figure = re.search(r'<figure class="view3d">(.*?)</figure>', html, re.DOTALL)
    assert figure
    assert figure[1].index("<img") < figure[1].index("<canvas")
    scene = json.loads(re.search(r'<script type="application/json">(.*?)</script>', figure[1], re.DOTALL)[1])
    assert {each["name"] for each in scene["parts"]} >= {"skin", "probe", "section"}
    assert 'getContext("webgl2"' in html
    assert len(page.all("canvas")) == 1


def test_every_picture_is_embedded_whole_and_described(whole):
    _, page = whole
    images = page.all("img")
    assert len(images) >= 8
    for attrs in images:
        assert len(attrs["alt"]) > 20
        head, content = attrs["src"].split(",", 1)
        data = base64.b64decode(content, validate=True)
        assert head.startswith("data:image/svg+xml") == data.lstrip().startswith(b"<?xml")


def test_ids_are_unique_and_links_lead_somewhere(whole):
    _, page = whole
    ids = [attrs["id"] for _, attrs in page.tags if "id" in attrs]
    assert len(ids) == len(set(ids))
    assert {attrs["href"][1:] for attrs in page.all("a")} <= set(ids)


def test_headings_go_down_step_by_step(whole):
    levels = [int(each) for each in re.findall(r"<h(\d)", (whole[0] / "report/report.html").read_text())]
    assert levels[:2] == [1, 2]
    assert all(b - a <= 1 for a, b in pairwise(levels))


def test_page_is_small(whole):
    out, _ = whole
    assert (out / "report" / "report.html").stat().st_size < 6e6


def test_parameter_table_is_laid_out_as_in_the_papers(whole):
    _, page = whole
    table = page.table("Mooney-Rivlin type (m = 2)")
    assert table[0] == ["site", "Mooney-Rivlin type (m = 2)", "Ogden type"]
    assert table[1] == ["c [kPa]", "m [–]", "κ′ [kPa]", "R² [–]"] * 2
    assert table[2] == [
        "p1",
        "10.1",
        "2.00",
        "above 527 κ′: weak",
        "0.9810",
        "10.1",
        "4.10",
        "above 527 κ′: weak",
        "0.9987",
    ]
    assert table[3] == ["p2", "– the fit has not been run", "– the fit has not been run"]


def test_open_intervals_are_said_in_words(whole):
    _, page = whole
    rows = page.table("95 % interval")
    row = next(row for row in rows if "fκ" in row)
    assert "above 52.0" in row
    assert "fκ is not identifiable from these data" in row[-1]


def test_headlines_of_what_is_open_are_words(whole):
    _, page = whole
    head = page.text.split("What the numbers mean")[0]
    assert "above 52.0" in head
    assert "80.0" not in head, "where the search ended is no result"
    assert "4.10" in head


def test_a_poor_fit_is_told_before_anything_else(tmp_path):
    case, out = make_case(tmp_path / "case"), tmp_path / "out"
    words = "it differs from the measured force by 3 N (RMSE under load); R2 0.61"
    add_fit(out, "p1", state="bad", words=words)
    glance = overview(gather(case, out=out))
    assert glance.sentence.startswith("Poor fit at p1: it differs from the measured force by 3 N")
    assert glance.mood == "failed"
    assert glance.sites[0].word == "bad"
    assert glance.sites[0].facts[0].remark.startswith("bad")
    assert glance.sites[0].sentence.startswith("Bad: it differs")


def test_page_of_a_case_that_cannot_be_read_has_a_paragraph_a_problem(tmp_path):
    folder = tmp_path / "S 9"
    folder.mkdir()
    (folder / "case.toml").write_text("format = 1\n[subject]\nlimb = 'middle'\n")
    with pytest.raises(CaseError) as caught:
        Case.open(folder)
    result = report_failure(folder, caught.value, out=tmp_path / "out")
    page = Page(result.path("page").read_text(encoding="utf-8"))
    n = len(caught.value.facts["problems"])
    assert n > 3
    assert len([each for each in page.all("div") if each.get("class") == "problem"]) == n
    assert f"{n} problems:" in page.text
    assert page.text.count("[subject] is missing 'id'") == 1, "not once more in one long line"
    assert f"limbcli check '{folder}'" in page.text
    assert "CASE" not in page.text


def test_summary_says_what_to_measure_next(tmp_path):
    case, out = make_case(tmp_path / "case"), tmp_path / "out"
    add_fit(out, "p1", noise="assumed")
    (steps,) = [each.next_steps for each in overview(gather(case, out=out)).sites]
    assert any(f"limbcli diagnose {case.folder} --site p1 --out {out}" in each for each in steps)
    assert any("Repeat one level" in each for each in steps)
    assert not any("Press deeper" in each for each in steps), "m is identified"
    with open_stage(out, "diagnose", subject="S1", site="p1") as writer:
        menu = [{"name": "larger", "sentence": "press with a larger probe"}, {"name": "b", "sentence": "x"}]
        writer.data["next_measurement"] = {
            "recommended": "larger", "expected_probability": 0.83, "menu": menu
        }  # fmt: skip
    (steps,) = [each.next_steps for each in overview(gather(case, out=out)).sites]
    assert steps[0].startswith(
        "Press with a larger probe (the true explanation then has a probability of 83 %"
    )
    assert not any("limbcli diagnose" in each for each in steps)
    assert not any("Measure the shear-wave speed" in each for each in steps)


@pytest.mark.parametrize(
    ("verdict", "taken"), [("named", "c and m of the diagnosis"), ("ambiguous", "do not use c")]
)
def test_summary_says_whose_parameters_hold_where_the_speeds_disagree(tmp_path, verdict, taken):
    case, out = make_case(tmp_path / "case"), tmp_path / "out"
    add_fit(out, "p1")
    page = gather(case, out=out)
    (site,) = page.sites
    with open_stage(out, "diagnose", subject="S1", site="p1") as writer:
        writer.data["verdict"] = verdict
    view = read_fit_view(read_result(out, "fit", site="p1"))
    view = replace(view, whole=replace(view.whole, state="bad", words="bad"))
    assert any(taken in each for each in next_steps(gather(case, out=out), site, view))


def test_a_curve_closer_than_its_noise_is_said_first_and_what_to_do(tmp_path):
    case, out = make_case(tmp_path / "case"), tmp_path / "out"
    add_fit(out, "p1")
    page = gather(case, out=out)
    (site,) = page.sites
    view = read_fit_view(read_result(out, "fit", site="p1"))
    view = replace(view, force=replace(view.force, state="doubtful", too_close=True))
    assert next_steps(page, site, view)[0].startswith("Give the levels as they were read, not smoothed")


def test_summary_asks_for_a_speed_where_c_was_given(tmp_path):
    case, out = make_case(tmp_path / "case"), tmp_path / "out"
    add_fit(out, "p1", c_kpa=9.0)
    (steps,) = [each.next_steps for each in overview(gather(case, out=out)).sites]
    assert any("Measure the shear-wave speed at 0 N" in each for each in steps)


def test_every_cell_of_a_table_has_its_columns_words_for_narrow_screens(whole):
    out, page = whole
    cells = page.all("td")
    assert len(cells) > 50
    assert all(attrs.get("data-label") or "colspan" in attrs for attrs in cells)
    labels = {attrs.get("data-label") for attrs in cells}
    assert {"Ogden type: m [–]", "Mooney-Rivlin type (m = 2): c [kPa]"} <= labels
    html = (out / "report" / "report.html").read_text(encoding="utf-8")
    assert "@media screen and (max-width: 40rem)" in html


def test_failed_and_missing_stages_have_their_place(whole):
    _, page = whole
    assert "mesh p3 failed" in page.text
    assert "the probe reaches beyond the skin" in page.text
    assert "move position_mm & try again" in page.text
    assert "There is no result of “fit” yet" in page.text
    assert re.search(r"limbcli fit \S+ --site p2 --out \S+", page.text)


def test_warnings_of_every_stage_stand_at_the_head(whole):
    _, page = whole
    head = page.text.split("What the numbers mean")[0]
    assert "the fibula is missing <in> two slices" in head
    assert "fκ trades off <with> c" in head


def test_a_report_tells_which_fits_it_shows(whole):
    reported = read_result(whole[0], "report").data["fitted_utc"]
    assert reported["p1"] == read_result(whole[0], "fit", site="p1").provenance["finished_utc"]


def test_speed_line_is_that_of_the_readings(whole):
    out, page = whole
    line = read_result(out, "report").data["sites"]["p1"]["swe_against_force"]
    assert line["slope_m_per_s_per_n"] == pytest.approx(0.055, rel=1e-3)
    assert line["r2"] == pytest.approx(1.0, abs=1e-4)
    assert page.table("speed against")[1][:2] == ["force", "0.0550 m/s per N"]


def add_predicted_speeds(out: Path, site: str) -> None:
    """What `fit` leaves of shear waves, added to its result."""
    folder = out / "fit" / site
    rows = ["depth_mm,simulated_force_n,predicted_m_per_s"]
    rows += [f"{d},{f:.5g},{v - 0.2:.5g}" for d, f, v in zip(DEPTH, FORCE, SPEED, strict=True)]
    (folder / "swe.csv").write_text("\n".join(rows) + "\n")
    content = json.loads((folder / "fit.json").read_text())
    for name in ("swe-maps", "stiffness-map"):
        small_png(folder / f"{name}.png")
    content["files"] |= {
        "swe": "swe.csv", "swe_maps_picture": "swe-maps.png", "stiffness_map": "stiffness-map.png",
    }  # fmt: skip
    content["data"] |= {
        "swe": {"rmse_m_per_s": 0.2},
        "stiffness_map": {
            "map": "level_00.csv", "n_elements": 900, "n_elements_within_image": 321,
            "median_kpa": 8.0, "low_kpa": 5.0, "high_kpa": 12.0,
        },
    }  # fmt: skip
    (folder / "fit.json").write_text(json.dumps(sealed(content)))


@pytest.mark.slow
def test_predicted_speeds_and_the_stiffness_map_are_shown_where_the_fit_left_them(tmp_path, whole):
    case, out = make_case(tmp_path / "case"), tmp_path / "out"
    add_fit(out, "p1")
    add_predicted_speeds(out, "p1")
    page = Page(report(case, out=out).path("page").read_text(encoding="utf-8"))
    described = " ".join(attrs["alt"] for attrs in page.all("img"))
    assert re.search(r"R² = \d\.\d+\. The fitted model predicts 2\.05 to", described), "two sentences"
    assert "predicted by the fitted model" in described
    assert "stiffness c of every element" in described
    assert "off by 0.20 m/s" in page.text
    assert "321 of 900 elements lie within the image" in page.text
    assert "predicts" not in " ".join(attrs["alt"] for attrs in whole[1].all("img")), "and nowhere else"


@pytest.mark.slow
def test_a_broken_table_of_predicted_speeds_becomes_words(tmp_path):
    case, out = make_case(tmp_path / "case"), tmp_path / "out"
    add_fit(out, "p1")
    add_predicted_speeds(out, "p1")
    (out / "fit" / "p1" / "swe.csv").write_text("depth_mm,force\n1,2\n")
    page = Page(report(case, out=out).path("page").read_text(encoding="utf-8"))
    assert "lack the column" in page.text


def test_provenance_names_solver_versions_hashes_and_units(whole):
    _, page = whole
    tail = page.text[page.text.index("How was this page made?") :]
    for word in ("febio", "4.11.0", "pardiso", "numpy", "mm-N-s (MPa)", "case.toml", "limbcli"):
        assert word in tail, word
    assert re.search(r"\b[0-9a-f]{64}\b", tail)


def test_figures_are_files_too(whole):
    out, _ = whole
    figures = out / "report" / "figures"
    for name in ("force-depth-p1", "wave-speed-p1", "section-p1", "skin-p1", "convergence-p1"):
        assert (figures / f"{name}.png").stat().st_size > 1000
        assert (figures / f"{name}.svg").read_text(encoding="utf-8").lstrip().startswith("<?xml")
        assert len((figures / f"{name}-data.csv").read_text(encoding="utf-8").splitlines()) > 5
    assert (figures / "segmentation.png").is_file()
    with (figures / "force-depth-p1-data.csv").open(newline="", encoding="utf-8") as stream:
        drawn = [
            (float(row["x"]), float(row["y"]))
            for row in csv.DictReader(stream)
            if row["kind"] == "line" and row["series"].startswith("measured")
        ]
    for depth, force in zip(DEPTH, FORCE, strict=True):
        assert min(abs(x - depth) + abs(y - force) for x, y in drawn) < 1e-3, "every level is in the table"


def test_every_caption_says_what_bad_looks_like(whole):
    _, page = whole
    assert page.text.count("Look for:") == page.text.count("Warning signs:") >= 8


def test_a_report_of_nothing_is_a_page_of_gaps(tmp_path):
    case = make_case(tmp_path / "case")
    result = report(case, out=tmp_path / "out")
    page = Page(result.path("page").read_text(encoding="utf-8"))
    assert result.data["mood"] == "missing"
    assert "The tissue was fitted at 0 of 1 site." in page.text
    for command in ("segment", "mesh", "run", "fit"):
        assert re.search(rf"limbcli {command} \S+( --site p1)? --out", page.text), command


def test_the_page_shows_the_limb_with_the_site_on_it(tmp_path):
    case, out = make_case(tmp_path / "case"), tmp_path / "out"
    corners = [(x, y, z) for x in (-40, 40) for y in (-30, 30) for z in (0, 200)]
    faces = [(0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1), (2, 3, 7), (2, 7, 6),
             (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3)]  # fmt: skip
    with open_stage(out, "segment", subject="S1") as writer:
        rows = [
            "ply", "format ascii 1.0", "element vertex 8", "property float x", "property float y",
            "property float z", "element face 12", "property list uchar int vertex_indices", "end_header",
            *(" ".join(map(str, each)) for each in corners), *(f"3 {a} {b} {c}" for a, b, c in faces),
        ]  # fmt: skip
        writer.file("skin", "skin.ply").write_text("\n".join(rows) + "\n")
    add_fit(out, "p1")
    page = Page(report(case, out=out).path("page").read_text(encoding="utf-8"))
    shown = [each for tag, each in page.tags if tag == "img" and "probe's face at site p1" in each["alt"]]
    assert len(shown) == 1
    assert "above the lower end of the limb in the images; " in page.text
    (out / "segment" / "skin.ply").write_text("not a surface")
    page = Page(report(case, out=out).path("page").read_text(encoding="utf-8"))
    assert "above the lower end" not in page.text


def test_weak_parameters_are_named_in_the_first_sentence(tmp_path):
    case, out = make_case(tmp_path / "case"), tmp_path / "out"
    add_fit(out, "p1")
    sentence = overview(gather(case, out=out)).sentence
    assert "Not reliable as tissue properties: f_κ at p1." in sentence
    path = out / "fit" / "p1" / "fit.json"
    content = json.loads(path.read_text().replace('"weak"', '"identified"'))
    path.write_text(json.dumps(sealed(content)))
    assert "All fitted parameters are identified." in overview(gather(case, out=out)).sentence


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ({"noise": "assumed"}, "noise is assumed, not measured"),
        ({"scale": 2.3}, "2.3 times as large"),
    ],
)
def test_what_a_parameter_rests_on_is_warned_of(tmp_path, kind, words):
    case, out = make_case(tmp_path / "case"), tmp_path / "out"
    add_fit(out, "p1", **kind)
    assert any(words in text for text in parameters(gather(case, out=out)).warned)
    add_fit(out, "p1")
    assert not any(words in text for text in parameters(gather(case, out=out)).warned)


def test_locking_is_warned_of_once_however_many_fits_it_touches(tmp_path):
    case, out = make_case(tmp_path / "case", sites=("p1", "p2")), tmp_path / "out"
    for site in ("p1", "p2"):
        add_fit(out, site, element="tet4")
    told = [each.text for each in overview(gather(case, out=out)).warnings]
    assert sum("lock" in text for text in told) == 1
    html = report(case, out=out).path("page").read_text(encoding="utf-8")
    assert html.count("is valid for this mesh only") == 1


def test_warnings_are_ranked_by_what_they_can_change_and_told_once(tmp_path):
    case, out = make_case(tmp_path / "case"), tmp_path / "out"
    add_segment(out)
    add_mesh(out, "p1")
    add_fit(out, "p1", scale=2.3)
    path = out / "fit" / "p1" / "fit.json"
    content = json.loads(path.read_text())
    content["data"]["boundary_check"] = {"cut_free": {"force_change_fraction": [-0.07, -0.1]}}
    path.write_text(json.dumps(sealed(content)))
    glance = overview(gather(case, out=out))
    kinds = [each.changes for each in glance.warnings]
    assert kinds == sorted(kinds, key=list(WarningKind).index)
    assert len({each.text for each in glance.warnings}) == len(glance.warnings)
    (model,) = [each for each in glance.warning_groups if each.changes == WarningKind.MODEL]
    assert "cut plane free, not held: force -10.0 to -7.0 %" in model.size
    html = report(case, out=out).path("page").read_text(encoding="utf-8")
    for each in glance.warnings:
        assert html.count(escape(each.text)) <= 1, "a section repeats what stands at the top"
    assert "about this, at the top of the page" in html


def test_many_warnings_fold_those_that_change_no_parameter_directly(tmp_path):
    page = gather(make_case(tmp_path / "case"), out=tmp_path / "out")
    stages = ("fit", *["mesh"] * 4)
    told = [SourcedWarning(f"{stage} p1", f"w{n}", changes_of(stage)) for n, stage in enumerate(stages)]
    assert [each.folded for each in warning_groups(told, page)] == [False, True]
    assert [each.folded for each in warning_groups(told[:3], page)] == [False, False]


def test_a_narrow_f_kappa_of_tet4_is_still_not_the_tissues(tmp_path):
    case, out = make_case(tmp_path / "case"), tmp_path / "out"
    add_fit(out, "p1", element="tet4")
    path = out / "fit" / "p1" / "fit.json"
    content = json.loads(path.read_text().replace('"weak"', '"identified"'))
    path.write_text(json.dumps(sealed(content)))
    glance = overview(gather(case, out=out))
    assert "f_κ at p1" in glance.sentence
    assert "of this tet4 mesh" in glance.sites[0].sentence
    assert any("property of this mesh" in each.text for each in glance.warnings)


def test_unreadable_levels_and_records_become_words(tmp_path):
    case, out = make_case(tmp_path / "case"), tmp_path / "out"
    write_run_of(out, "p1")
    (out / "run" / "p1" / "nodes.csv").write_text("*Step = 1\n")
    case.sites[0].levels.write_text("force_n,depth_mm\n1,2\n")
    result = report(case, out=out)
    page = Page(result.path("page").read_text(encoding="utf-8"))
    assert "p1.csv cannot be used" in page.text
    assert "cannot be drawn" in page.text
    assert "nodes.csv cannot be used" in result.warnings[-1]


@pytest.mark.slow
@pytest.mark.parametrize(
    "content",
    [b"", b"time_s,depth_mm", b"time_s,depth_mm,force_n\n1,2", b"time_s,depth_mm\n1,2\n", b"\x00\xff\n,",
     b"time_s,depth_mm,force_n\n1,2,3,4\n", b"time_s,depth_mm,force_n\n,,\n", b"depth_mm\n" + b"1" * 200_000],
    ids=["empty", "header", "cut", "no force", "binary", "long row", "gaps", "long field"],
)  # fmt: skip
def test_a_damaged_force_depth_curve_becomes_words(tmp_path, content):
    case, out = make_case(tmp_path / "case"), tmp_path / "out"
    with open_stage(out, "run", subject="S1", site="p1") as writer:
        writer.file("force_depth", "force-depth.csv").write_text("time_s,depth_mm,force_n\n1,2,3\n")
    (out / "run" / "p1" / "force-depth.csv").write_bytes(content)
    found = report(case, out=out)
    assert any("force-depth.csv" in each and "was changed since" in each for each in found.warnings)


@pytest.mark.parametrize(("before", "after"), [("mesh", "mesh-study"), ("build-feb", "diagnose")])
def test_a_result_older_than_one_that_it_does_not_record_is_told(tmp_path, before, after):
    case, out = make_case(tmp_path / "case"), tmp_path / "out"
    for stage in (before, after):
        with open_stage(out, stage, subject="S1", site="p1"):
            pass
    assert not any("older" in text for text in gather(case, out=out).notices)
    path = out / after / "p1" / f"{after}.json"
    content = json.loads(path.read_text())
    content["provenance"]["finished_utc"] = "2001-01-01T00:00:00Z"
    path.write_text(json.dumps(sealed(content)))
    assert any(f"“{after} p1”" in text and "older" in text for text in gather(case, out=out).notices)


@pytest.mark.slow
def test_users_template_replaces_ours(tmp_path):
    case = make_case(tmp_path / "case")
    (tmp_path / "mine" / "report").mkdir(parents=True)
    (tmp_path / "mine" / "report" / "style.css").write_text("body { color: rebeccapurple }")
    result = report(case, out=tmp_path / "out", templates=tmp_path / "mine")
    html = result.path("page").read_text(encoding="utf-8")
    assert "rebeccapurple" in html
    assert "At a glance" in html


@pytest.mark.slow
@pytest.mark.parametrize("content", ["{% if %}", "{{ nothing_like_it }}"])
def test_a_faulty_template_of_the_users_is_named_and_leaves_no_half_page(tmp_path, content):
    case = make_case(tmp_path / "case")
    (tmp_path / "mine" / "report").mkdir(parents=True)
    (tmp_path / "mine" / "report" / "report.html.j2").write_text(content)
    with pytest.raises(CaseError, match="a template is invalid") as caught:
        report(case, out=tmp_path / "out", templates=tmp_path / "mine")
    assert "mine" in caught.value.where
    assert not (tmp_path / "out").exists()


def test_a_folder_of_templates_that_is_not_there_is_named(tmp_path):
    case = make_case(tmp_path / "case")
    with pytest.raises(ToolError, match="nope does not exist"):
        report(case, out=tmp_path / "out", templates=tmp_path / "nope")


def test_a_template_of_the_users_that_nothing_uses_is_refused(tmp_path):
    (tmp_path / "report").mkdir()
    (tmp_path / "report" / "README.md").write_text("what I changed")
    (tmp_path / "report" / "failure.html.j2").write_text(
        "as ours is called, though no page of this kind is made"
    )
    (tmp_path / "report" / "index.html.j2").write_text("{% include 'own.j2' %}")
    (tmp_path / "report" / "own.j2").write_text("mine")
    assert render("index.html.j2", {}, templates=tmp_path) == "mine"
    (tmp_path / "report" / "styles.css").write_text("body { color: red }")
    with pytest.raises(CaseError, match=r"styles\.css is not used") as caught:
        render("index.html.j2", {}, templates=tmp_path)
    assert "did you mean style.css" in caught.value.fix


def add_on_demand(out: Path) -> None:
    """Joint fit with laws, elements side by side and a mesh study, as their stages leave them."""
    parameters = step_data(m=4.1, m_free=True, r2=0.99, rmse_n=0.2)["parameters"]
    laws = [
        {
            "law": law, "n_parameters": 3, "held_out_depth_mm": miss, "held_out_speed_fraction": speed,
            "chi_square": 9.1, "c_kpa": 8.0, "shape": {"f_kappa": 20.2},
        }
        for law, miss, speed in (("two-term-ogden", 0.21, 0.021), ("holmes-mow", 0.25, None))
    ]  # fmt: skip
    with open_stage(out, "fit-joint", subject="S1") as writer:
        writer.data.update(
            parameters=parameters, laws=laws, law="ogden", law_words="Ogden type", element="tet10",
            sites=["p1"], chi_square=11.5, n_freedom=12, gains={"p1": 1.02}, gain_deviations={"p1": 0.03},
            boundary_check={"p1": {"cut_free": {"force_change_fraction": [-0.01, -0.097]}}},
        )  # fmt: skip
        small_png(writer.file("picture", "fit-joint.png"))
    with open_stage(out, "fit-elements", subject="S1", site="p1") as writer:
        row = {"n_unknowns": 315, "f_kappa": 20.0, "m": 5.0, "r2": 0.99, "rmse_n": 0.1}
        writer.data["elements"] = {"tet4": row, "tet10": {**row, "f_kappa": 777.0}}
        small_png(writer.file("picture", "elements.png"))
    with open_stage(out, "mesh-study", subject="S1", site="p1") as writer:
        writer.data.update(numerical_error_fraction=0.034, force_n=12.0)
        small_png(writer.file("picture", "study.png"))


@pytest.mark.slow
def test_what_was_made_on_demand_is_on_the_page(tmp_path):
    case, out = make_case(tmp_path / "case"), tmp_path / "out"
    add_fit(out, "p1")
    add_on_demand(out)
    page = Page(report(case, out=out).path("page").read_text(encoding="utf-8"))
    assert page.table("two-term-ogden")[1][:4] == ["two-term-ogden", "3", "0.210", "2.10"]
    assert "not predicted" in page.table("two-term-ogden")[2][3]
    assert page.table("777")[2][:3] == ["tet10", "315", "777"]
    assert "chi-square 11.5 for 12 degrees of freedom" in page.text
    assert "multiplied by 1.02 (error of mesh and boundaries allowed: 3.0 %)" in page.text
    assert page.table("cut plane free")[1][:2] == ["cut plane free, not held", "-9.7 to -1.0 %"]
    assert {"fit-joint", "laws", "fit-elements-p1", "mesh-study-p1"} <= {
        attrs["id"] for _, attrs in page.tags if "id" in attrs
    }
    assert "f_κ" not in page.text, "set as a symbol everywhere"


def test_a_joint_fit_that_misses_its_data_is_not_marked_as_fine(tmp_path):
    case, out = make_case(tmp_path / "S1"), tmp_path / "out"
    sound = {"c_kpa": {"value": 8.0, "low": 7.0, "high": 9.0, "flag": "identified"}}
    for warnings, mood in (
        ((), "fine"),
        (("the shape of the limb is assumed",), "warning"),
        ((), "failed"),
    ):
        told = vars(chi_square_agreement(73.0 if mood == "failed" else 3.0, 4))
        for stage, site in (("fit-joint", None), ("fit-states", "p1")):
            with open_stage(out, stage, subject="S1", site=site) as writer:
                writer.data.update(parameters=sound, element="tet10", sites=["p1"], agreement=told)
                writer.warnings += warnings
        page = gather(case, out=out)
        assert [each.mood for each in (joint(page), states(page, page.sites[0])) if each] == [mood, mood]


def test_laws_of_a_joint_fit_that_failed_since_are_not_shown(tmp_path):
    """A batch leaves the result before beside the failure, to make it again."""
    case, out = make_case(tmp_path / "S1"), tmp_path / "out"
    add_on_demand(out)
    assert laws(gather(case, out=out)) is not None
    fail(out, "fit-joint", None)
    assert laws(gather(case, out=out)) is None


def test_what_was_not_made_on_demand_is_not_missed(whole):
    ids = {attrs["id"] for _, attrs in whole[1].tags if "id" in attrs}
    assert not ids & {"fit-joint", "laws", "fit-elements-p1", "mesh-study-p1"}


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["folder", "file"])
def test_a_users_own_report_is_not_replaced(tmp_path, kind):
    case, out = make_case(tmp_path / "case"), tmp_path / "out"
    own = out / "report" / "thesis.txt" if kind == "folder" else out / "report"
    own.parent.mkdir(parents=True)
    own.write_text("mine")
    for _ in range(2):
        with pytest.raises(CaseError, match="not made by limbcli") as caught:
            report(case, out=out)
        assert caught.value.where == str(out / "report")
        keep_error(out, "report", None, caught.value)  # as a batch does
    assert own.read_text() == "mine"
    (out / "report").rename(out / "my-report")
    assert report(case, out=out).path("page").is_file()
    keep_error(out, "report", None, caught.value)
    assert report(case, out=out).path("page").is_file(), "a failure of ours is replaced"


def add_diagnosis(out: Path, *, subject: str = "S1") -> None:
    stage = {
        "explanation": [], "chi2_per_nu": 4.0, "held_out": {}, "values": {}, "intervals_95": {},
        "open_ends": {}, "c_and_m_over": 1,
    }  # fmt: skip
    with open_stage(out, "diagnose", subject=subject, site="p1") as writer:
        for name in ("gap", "candidates"):
            small_png(writer.file(name, f"{name}.png"))
        writer.data.update(
            verdict="named", added=["skin_layer"], sentences=["The skin is stiff."], candidates=[],
            not_evaluated={}, blind_spots=[], explanations=[], confidence_set=[],
            sizes_95={}, common_errors=[],
            shrink=[stage, {**stage, "explanation": ["skin_layer"], "chi2_per_nu": 1.0}],
        )  # fmt: skip


@pytest.mark.slow
def test_a_diagnosis_is_on_the_page_of_its_own_subject_only(tmp_path):
    case, out = make_case(tmp_path / "case"), tmp_path / "out"
    add_fit(out, "p1")
    add_diagnosis(out)
    result = report(case, out=out)
    assert any("skin_layer (named)" in each for each in result.summary)
    page = result.path("page").read_text()
    assert 0 < page.index("The skin is stiff.") < page.index('alt="Measured minus'), "the answer comes first"
    add_diagnosis(out, subject="S2")
    result = report(case, out=out)
    assert not any("skin_layer" in each for each in result.summary)
    page = result.path("page").read_text()
    assert "The skin is stiff." not in page
    assert "the result is of S2, but the case is of S1" in page


@pytest.mark.slow
def test_a_diagnosis_that_cannot_be_shown_whole_does_not_stop_the_page(tmp_path):
    case, out = make_case(tmp_path / "case"), tmp_path / "out"
    add_diagnosis(out)
    (out / "diagnose" / "p1" / "gap.png").unlink()
    page = report(case, out=out).path("page").read_text()
    assert "The skin is stiff." in page
    path = out / "diagnose" / "p1" / "diagnose.json"
    path.write_text(
        json.dumps(sealed(json.loads(path.read_text()) | {"data": {"added": ["x"], "shrink": [{}, {}]}}))
    )
    result = report(case, out=out)
    assert "Its result cannot be shown (KeyError: &#39;sentences&#39;)" in result.path("page").read_text()


def test_the_limit_of_an_interval_is_said_once_and_the_panel_states_the_interval(tmp_path):
    case, out = make_case(tmp_path / "case"), tmp_path / "out"
    add_fit(out, "p1", scale=1.9)
    path = out / "fit" / "p1" / "fit.json"
    content = json.loads(path.read_text())
    content["data"]["n_freedom"] = 3
    content["data"]["steps"]["ogden"]["profiles"] = {
        "m": {"values": [1, 2], "deviance": [3, 0], "limit": 9.98, "extended_to_fit": True}
    }
    path.write_text(json.dumps(sealed(content)))
    page = gather(case, out=out)
    found = profiles(page, page.sites[0])
    assert found.mood == "warning", "f_kappa is open"
    assert "m: 3.70\u00a0to\u00a04.50 (95 %), identified" in found.answer
    text = " ".join(found.notes)
    assert text.count("9.98 instead of 3.84") == 1
    assert "1.9 times as much" in text
    assert "3 degrees of freedom" in text
    assert "extended to the value of the published fit" in text


def test_the_card_leads_with_what_is_known_and_says_once_what_is_open(tmp_path):
    case, out = make_case(tmp_path / "case"), tmp_path / "out"
    add_fit(out, "p1")
    (site,) = overview(gather(case, out=out)).sites
    values = {each.name: (each.value, each.remark) for each in site.facts}
    shown = [each.replace("\u00a0", " ") for each in values["µ at rest, shear modulus"]]
    assert shown == ["5.07 kPa", "95 %: 4.55 to 5.60; c/2"], "half of c and of its interval"
    assert values["E at rest, Young’s modulus"][0].startswith("15.2")
    assert list(values)[:3] == ["µ at rest, shear modulus", "E at rest, Young’s modulus", "c = 2µ"]
    assert not any("f_κ" in name or "above" in value for name, (value, _) in values.items())
    assert "Left open by these data: f_κ above 52.0 (weak)." in site.sentence
    assert (site.mood, site.word) == ("fine", "good")


def test_the_methods_of_a_run_are_told_with_its_numbers_versions_and_citations(whole):
    out, _ = whole
    told = (out / "report" / "methods.txt").read_text(encoding="utf-8")
    data = read_result(out, "fit", site="p1").data
    c_kpa = data["steps"]["ogden"]["c_kpa"]
    mu = significant(0.5 * c_kpa)
    assert f"mu = c/2 = {mu} kPa" in told
    assert "identified as published [Ranger 2023]" in told
    assert "10.1016/j.jmbbm.2022.105541" in told
    assert f"limbcli {__version__}" in told
    assert f"agreement with the data: {data.get('agreement', {}).get('state', 'untested')}" in told
    rms = data["agreement"]["force"]["rms"]
    assert f"root mean square difference under load {significant(rms)} N" in told, "as the page shows it"
    for key in re.findall(r"\[([A-Z][a-z]+ \d{4})\]", told):
        assert f"[{key}] {key.split()[0]} " in told  # each citation has its reference
    html = (out / "report/report.html").read_text(encoding="utf-8")
    assert "What could a paper say of the methods?" in html
    assert f"E = 3 mu = {significant(1.5 * c_kpa)} kPa" in html


def test_the_methods_cite_only_what_was_run(tmp_path: Path):
    case = make_case(tmp_path / "case")
    report(case, out=tmp_path / "out")
    told = (tmp_path / "out" / "report" / "methods.txt").read_text(encoding="utf-8")
    assert told.startswith("Computed by limbcli")
    assert "Ranger" not in told
    assert "TetGen" not in told


def test_a_case_without_sites_and_probe_gets_its_page(tmp_path: Path):
    for name, body in (("skin", prism(30.0, -60, 60)), ("tibia", prism(9.0, -55, 55, x=4.0))):
        meshio.Mesh(body.points, [("triangle", body.faces)]).write(tmp_path / f"{name}.ply")
    (tmp_path / "case.toml").write_text(CASE_TOML.partition("[probe]")[0])
    found = batch(tmp_path, out=tmp_path / "out")
    assert not found.failures
    page = found.report.read_text()
    assert "the case has no site" in page
    assert "chapter-parameters" not in page
    (tmp_path / "case.toml").write_text(CASE_TOML.partition("[probe]")[0] + "[[site]]\nname = 'p1'\n")
    assert batch(tmp_path, out=tmp_path / "out").failures  # sites that are there must be complete
