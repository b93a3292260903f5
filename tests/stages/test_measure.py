"""measure: the instruments' files of one site become its levels.csv."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from limbcli.case import Case
from limbcli.errors import CaseError, MeasurementError
from limbcli.measurement.elastography import SweMap, read_map
from limbcli.measurement.holds import find_holds
from limbcli.measurement.indentation import read_levels
from limbcli.measurement.swe_image import DecodedMap
from limbcli.results import open_stage
from limbcli.stages.measure import measure
from limbcli.stages.measuring.holds import columns_of, found_twice, holds_of
from limbcli.stages.measuring.images import TissueBetween, images_of, within_tissue
from tests.case.test_case_text import HEAD, SITE
from tests.measurement.test_bmode import frame, speckle
from tests.measurement.test_holds import record
from tests.measurement.test_swe_image import BAR, BOX, ramp, render
from tests.measurement.test_ultrasound_image import loop, screen, stored

FORCES = (0.0, 2.0, 4.0, 6.0)
BONE_ROWS = (300.0, 290.0, 279.0, 270.0)
TABLES = f"""
[site.load_cell]
file = "cell.csv"
columns = {{ time_s = "t", force_n = "F" }}
force_unit = "kgf"
[site.b_mode]
folder = "bmode"
mm_per_pixel = 0.1
[site.swe_images]
folder = "swe"
mm_per_pixel = 0.1
box_pixels = {list(BOX)}
bar_pixels = {list(BAR)}
low_m_per_s = 0.5
high_m_per_s = 10.5
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A case whose site p1 has a load-cell record in kgf and PNG images of four levels."""
    rng = np.random.default_rng(7)
    folder = tmp_path_factory.mktemp("case")
    for name in ("mri", "bmode", "swe"):
        (folder / name).mkdir()
    (folder / "case.toml").write_text(HEAD + SITE.format(name="p1", levels="p1.csv") + TABLES)
    trace = record(rng, levels=FORCES)
    pairs = zip(trace.time, trace.force / 9.80665, strict=True)
    rows = "\n".join(f"{time:.4f};{force:.6f}".replace(".", ",") for time, force in pairs)
    (folder / "cell.csv").write_text("t;F\n" + rows + "\n")
    tissue = speckle(rng)
    for k, row in enumerate(BONE_ROWS):
        Image.fromarray(frame(rng, row, tissue).rgb).save(folder / "bmode" / f"{k}.png")
        speed = np.clip(ramp() * (1 + 0.1 * k), 0, 10)
        Image.fromarray(render(rng, speed).rgb).save(folder / "swe" / f"{k}.png")
    return folder


def test_images_follow_the_numbers_in_their_names(tmp_path: Path):
    for k in range(12):
        Image.fromarray(np.full((20, 20, 3), k, np.uint8)).save(tmp_path / f"level{k}.png")
    (tmp_path / "._level0.png").write_bytes(b"what a Mac leaves")
    images = images_of({"path": tmp_path, "mm_per_pixel": 0.1})
    assert [int(each.rgb[0, 0, 0]) for each in images] == list(range(12))


def test_a_resized_picture_has_not_the_scale_that_is_stated_for_all(tmp_path: Path):
    whole = Image.fromarray(np.full((200, 300, 3), 9, np.uint8))
    for k, picture in enumerate((whole, whole.crop((0, 0, 300, 170)))):  # cut off below: the same scale
        picture.save(tmp_path / f"{k}.png")
    assert len(images_of({"path": tmp_path, "mm_per_pixel": 0.1})) == 2
    whole.resize((270, 180)).save(tmp_path / "2.png")
    with pytest.raises(MeasurementError, match="270 by 180 pixels, the first 300 by 200: it was resized"):
        images_of({"path": tmp_path, "mm_per_pixel": 0.1})


def test_a_film_is_told_from_an_empty_folder(tmp_path: Path):
    (tmp_path / "press.mp4").write_bytes(b"film")
    with pytest.raises(MeasurementError) as caught:
        images_of({"path": tmp_path, "mm_per_pixel": 0.1})
    assert "press.mp4 is a film: save the frame of every hold as PNG" in caught.value.fix


def test_dicom_images_need_no_ending(tmp_path: Path):
    for k in range(3):
        stored(tmp_path / f"IM_{k}", screen().tobytes())
    (tmp_path / "notes").write_text("as measured")
    assert len(images_of({"path": tmp_path, "mm_per_pixel": None})) == 3


def test_frames_of_one_loop_or_of_a_loop_a_level_are_the_levels_images(tmp_path: Path):
    def greys(frame: object) -> list[int]:
        found = images_of({"path": tmp_path, "mm_per_pixel": 0.1, "frame": frame})
        return [int(each.rgb[0, 0, 0]) for each in found]

    loop(tmp_path / "a.dcm")
    assert greys([1, 4, 2]) == [10, 40, 20]
    loop(tmp_path / "b.dcm")
    assert greys(3) == [30, 30]
    assert greys([2, 4]) == [20, 40]
    with pytest.raises(MeasurementError, match="frame lists 3 frames, the folder contains 2 images"):
        greys([1, 2, 3])
    with pytest.raises(MeasurementError, match="it is not stated which"):
        greys(None)


@pytest.mark.slow
@pytest.mark.drawn
def test_levels_are_those_the_instruments_saw(folder: Path, tmp_path: Path):
    result = measure(Case.open(folder), out=tmp_path)[0]
    levels = read_levels(result.path("levels"))
    np.testing.assert_allclose(levels.force, FORCES, atol=0.02)
    np.testing.assert_allclose(levels.depth, (300.0 - np.array(BONE_ROWS)) * 0.1, atol=0.1)
    np.testing.assert_allclose(levels.swe_mean_m_per_s, 5.0 * (1 + 0.1 * np.arange(4)), rtol=0.02)
    for name in ("holds_picture", "bone_picture", "speed_picture"):
        assert result.path(name).stat().st_size > 10_000
    assert len(list((result.folder / "swe").glob("level_*.csv"))) == 4


def test_a_cine_loop_in_kpa_at_half_opacity_gives_speeds(folder: Path, tmp_path: Path):
    """E = 3 rho v^2: the bar is even in kPa, so that a colour at fraction f is 10 sqrt(f) m/s of 300 kPa."""
    rng = np.random.default_rng(7)
    text = (folder / "case.toml").read_text()
    case = tmp_path / "case"
    shutil.copytree(folder, case, ignore=shutil.ignore_patterns("*.png"))
    text = text[: text.index("[site.load_cell]")] + (
        '[site.swe_images]\nfolder = "swe"\nmm_per_pixel = 0.1\nhigh_kpa = 300\nopacity = 0.5\n'
        "frame = [2, 4, 5, 6]\n"
    )
    (case / "case.toml").write_text(text)
    rows = ["force_n,depth_mm,hold_s", *(f"{2 * k},{k},20" for k in range(4))]
    (case / "p1.csv").write_text("\n".join(rows) + "\n")
    fractions = (0.9, 0.2, 0.9, 0.3, 0.4, 0.6)
    frames = [
        Image.fromarray(render(rng, np.full(ramp().shape, 0.5 + 10 * each), 0.5).rgb) for each in fractions
    ]
    frames[0].save(case / "swe" / "loop.tif", save_all=True, append_images=frames[1:])
    levels = read_levels(measure(Case.open(case), out=tmp_path / "out")[0].path("levels"))
    expected = 10 * np.sqrt([fractions[k - 1] for k in (2, 4, 5, 6)])
    np.testing.assert_allclose(levels.swe_mean_m_per_s, expected, rtol=0.01)


@pytest.mark.slow
def test_levels_are_written_to_the_case_once_and_never_over_a_file(folder: Path, tmp_path: Path):
    case = Case.open(folder)
    measure(case, out=tmp_path, write=True)
    try:
        assert len(read_levels(case.sites[0].levels)) == 4
        with pytest.raises(CaseError, match="not overwritten") as caught:
            measure(case, out=tmp_path, write=True)
        assert str(tmp_path / "measure" / "p1" / "levels.csv") in str(caught.value)
    finally:
        case.sites[0].levels.unlink()


@pytest.mark.slow
def test_missing_image_is_said_with_the_counts(folder: Path, tmp_path: Path):
    extra = folder / "bmode" / "3.png"
    content = extra.read_bytes()
    extra.unlink()
    try:
        with pytest.raises(MeasurementError, match="numbers of levels: force_n 4"):
            measure(Case.open(folder), out=tmp_path)
    finally:
        extra.write_bytes(content)
    assert not (tmp_path / "measure" / "p1").exists(), "nothing half-made stays"


def test_missing_levels_are_only_allowed_where_instruments_give_them(folder: Path):
    case = Case.open(folder)
    with pytest.raises(MeasurementError, match="limbcli measure"):
        read_levels(case.sites[0].levels)


ONLY_CELL = '[site.load_cell]\nfile = "cell.csv"\ncolumns = { time_s = "t", force_n = "F" }\n'


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda time, force: (time, 102.0 * force), "spans .* to 6.. N"),
        (lambda time, force: (1000.0 * time, force), "are its times in ms"),
        (lambda time, force: (time, 0.0 * force), "only one level"),
        (lambda time, force: (time, np.full(len(force), np.nan)), "0 of .* samples"),
    ],
    ids=["grams", "milliseconds", "one level", "no force"],
)
def test_a_record_that_cannot_be_meant_is_refused(folder: Path, tmp_path: Path, rng, change, message):
    with pytest.raises(MeasurementError, match=message):
        measure(cell_only(folder, tmp_path, *change(*times_and_forces(rng))), out=tmp_path / "out")


def test_lost_samples_and_tiny_forces_are_doubted(folder: Path, tmp_path: Path, rng):
    time, force = times_and_forces(rng)
    result = measure(cell_only(folder, tmp_path, time, force / 9.81), out=tmp_path / "out")[0]
    assert any("kgf" in text for text in result.warnings)
    force[::5] = np.nan
    result = measure(cell_only(folder, tmp_path, time, force), out=tmp_path / "out")[0]
    assert any("contain no force" in text for text in result.warnings)
    assert not any("kgf" in text for text in result.warnings)


def times_and_forces(rng) -> tuple[np.ndarray, np.ndarray]:
    trace = record(rng, levels=FORCES)
    return trace.time.copy(), trace.force.copy()


def cell_only(folder: Path, place: Path, time: np.ndarray, force: np.ndarray) -> Case:
    """The case with nothing but a load-cell record."""
    place = place / "cell"
    (place / "mri").mkdir(parents=True, exist_ok=True)
    (place / "case.toml").write_text(HEAD + SITE.format(name="p1", levels="p1.csv") + ONLY_CELL)
    rows = "\n".join(f"{a:.4f},{'' if np.isnan(b) else f'{b:.6f}'}" for a, b in zip(time, force, strict=True))
    (place / "cell.csv").write_text("t,F\n" + rows + "\n")
    return Case.open(place)


# ---------------------------------------------------------------- found, left out, taken over


def test_a_level_whose_force_moved_is_told_where_it_is_found_as_two(rng):
    trace = record(rng, levels=(0, 2, 4), hold=14.0)
    moved = np.where(trace.time > 41.0, 0.3, 0.0)  # in the midst of the last hold
    holds = find_holds(replace(trace, force=trace.force + moved))
    reported = found_twice(holds, 2.0)
    assert len(holds) == 4
    assert len(reported) == 1
    assert "holds 2 and 3" in reported[0]
    assert found_twice(find_holds(trace), 2.0) == []


def test_a_tare_at_the_record_s_end_leaves_no_holds_and_is_told_so(tmp_path: Path, rng):
    path = tmp_path / "cell.csv"
    trace = record(rng, levels=(0, 2))
    np.savetxt(
        path, np.column_stack([trace.time, trace.force]), delimiter=",", header="time_s,force_n", comments=""
    )
    table = {
        "path": path, "columns": {}, "time_unit": None, "force_unit": None, "length_unit": None,
        "separator": None,
        "decimal": None, "tare_s": [20.0, 24.0], "probe_mass_kg": 0.0, "axis": "z",
        "hold_s": 5.0, "hold_tolerance_n": 0.1,
    }  # fmt: skip
    with pytest.raises(MeasurementError, match="ends 0 s after tare_s"):
        holds_of(table)


def test_a_trace_alone_is_a_load_cell_record(tmp_path: Path, rng):
    (tmp_path / "mri").mkdir()
    site = SITE.format(name="p1", levels='p1.csv"\ntrace = "trace.csv')
    (tmp_path / "case.toml").write_text(HEAD + site)
    trace = record(rng, levels=FORCES)
    rows = "\n".join(f"{t:.4f},{f:.4f}" for t, f in zip(trace.time, trace.force, strict=True))
    (tmp_path / "trace.csv").write_text("time_s,force_n\n" + rows + "\n")
    result = measure(Case.open(tmp_path), out=tmp_path / "out")[0]
    assert len(result.data["holds"]) == 4


def test_depth_and_travel_of_the_record_become_columns(rng):
    trace = record(rng, levels=FORCES)
    travel = 100.0 + 2.0 * trace.force
    travel[trace.force < 1.0] = np.nan
    columns = columns_of(find_holds(replace(trace, depth=5.0 + 1.5 * trace.force, probe_travel=travel)), 2.0)
    np.testing.assert_allclose(columns["depth_mm"], 1.5 * np.array(FORCES), atol=0.05)
    np.testing.assert_allclose(
        columns["probe_travel_mm"], [np.nan, *(100 + 2 * np.array(FORCES[1:]))], atol=0.05
    )


def without(folder: Path, target: Path, *keys: str, more: str = "") -> Case:
    """The case of `folder` with lines of case.toml left out and others put to the elastography."""
    target.mkdir()
    lines = (folder / "case.toml").read_text().splitlines()
    kept = [line for line in lines if not line.startswith(keys)]
    (target / "case.toml").write_text("\n".join(kept) + "\n" + more)
    for name in ("mri", "bmode", "swe", "cell.csv"):
        copy = shutil.copytree if (folder / name).is_dir() else shutil.copyfile
        copy(folder / name, target / name)
    return Case.open(target)


@pytest.mark.slow
def test_bar_and_box_are_found_and_the_same_speeds_come_out(folder: Path, tmp_path: Path):
    stated = measure(Case.open(folder), out=tmp_path / "a")[0]
    case = without(folder, tmp_path / "case", "box_pixels", "bar_pixels")
    found = measure(case, out=tmp_path / "b")[0]
    assert any("bar_pixels found" in line for line in found.summary)
    mine, theirs = (read_levels(each.path("levels")).swe_mean_m_per_s for each in (found, stated))
    np.testing.assert_allclose(mine, theirs, rtol=5e-3)


@pytest.mark.slow
def test_skin_fat_and_bone_are_left_out_of_the_speeds(folder: Path, tmp_path: Path):
    plain = measure(Case.open(folder), out=tmp_path / "a")[0]
    assert any("skin and fat are excluded" in text for text in plain.warnings)
    with open_stage(tmp_path / "b", "segment", subject="S1") as writer:
        writer.data["layers"] = {"p1": {"skin_mm": 1.5, "fat_mm": 6.5}}
    result = measure(Case.open(folder), out=tmp_path / "b")[0]
    assert not any("skin and fat" in text for text in result.warnings)
    for level, row in enumerate(BONE_ROWS):
        depth = read_map(result.folder / "swe" / f"level_{level:02d}.csv").depth
        assert depth.min() >= 8.0
        assert depth.max() <= 0.1 * row - 1.5 + 0.2


def test_pixels_at_the_end_of_the_bar_are_told_where_the_tissue_has_them_though_the_box_has_few(
    tmp_path: Path,
):
    depth = np.repeat(np.arange(40.0), 5)
    at_end = (depth >= 36.0) & (depth < 39.0)  # 7 % of the box, three quarters of the muscle
    swe = SweMap(np.tile(np.arange(5.0), 40), depth, np.full(200, 2.0))
    table = {"roi_lateral_mm": None, "roi_depth_mm": [36.0, 40.0]}
    with open_stage(tmp_path, "measure", subject="S1") as writer:
        part = within_tissue([DecodedMap(swe, at_end, 0, 0, 0)], table, TissueBetween(None, None), writer)
        assert len(part[0]) == 5
        assert any("level 0: 75 % of the pixels are at an end" in each for each in writer.warnings)


@pytest.mark.slow
def test_bone_read_by_hand_at_every_level_wins(folder: Path, tmp_path: Path):
    bone = "bone_mm = [24.0, 23.0, 22.0, 21.0]\n"
    toml = (folder / "case.toml").read_text()
    case = without(folder, tmp_path / "case", "-")
    (tmp_path / "case" / "case.toml").write_text(toml.replace("[site.b_mode]\n", "[site.b_mode]\n" + bone))
    levels = read_levels(measure(Case.open(case.folder), out=tmp_path / "a")[0].path("levels"))
    np.testing.assert_allclose(levels.depth, [0, 1, 2, 3], atol=1e-9)
    short = toml.replace("[site.b_mode]\n", "[site.b_mode]\nbone_mm = [24.0, 23.0]\n")
    (tmp_path / "case" / "case.toml").write_text(short)
    with pytest.raises(MeasurementError, match="states 2 distances, there are 4 images"):
        measure(Case.open(case.folder), out=tmp_path / "b")
    deeper = toml.replace("[site.b_mode]\n", "[site.b_mode]\nbone_mm = [21.0, 21.0, 21.0, 26.0]\n")
    (tmp_path / "case" / "case.toml").write_text(deeper)
    with pytest.raises(MeasurementError, match=r"depth_mm is -5; .*\(level 3\)") as caught:
        measure(Case.open(case.folder), out=tmp_path / "c")
    assert "bmode" in caught.value.where
    assert "bone_mm as a list" in caught.value.fix


@pytest.mark.slow
def test_maps_go_where_the_case_names_them(folder: Path, tmp_path: Path):
    case = without(folder, tmp_path / "case", "-")
    text = (case.folder / "case.toml").read_text()
    named = text.replace("[site.load_cell]", 'swe_maps = "maps"\n[site.load_cell]')
    (case.folder / "case.toml").write_text(named)
    measure(Case.open(case.folder), out=tmp_path / "a", write=True)
    assert len(list((case.folder / "maps").glob("level_*.csv"))) == 4
    assert (case.folder / "p1.csv").is_file()
    (case.folder / "p1.csv").unlink()
    again = measure(Case.open(case.folder), out=tmp_path / "b", write=True)[0]
    assert any("the maps in maps already existed" in each for each in again.warnings)


@pytest.mark.slow
def test_level_0_may_follow_the_air_without_a_gap(folder: Path, tmp_path: Path, rng):
    """The tare in the air and the hold at first touch both read about 0 N: level 0 is not lost."""
    time, force = times_and_forces(rng)
    step = float(np.median(np.diff(time)))
    air = np.arange(0.0, 6.0, step)
    case = cell_only(folder, tmp_path, np.r_[air, time + 6.0 + step], np.r_[np.zeros(len(air)), force] + 0.7)
    toml = case.folder / "case.toml"
    toml.write_text(toml.read_text() + "tare_s = [0.0, 5.0]\n")
    result = measure(Case.open(case.folder), out=tmp_path / "out")[0]
    forces = [each["force"] for each in result.data["holds"]]
    np.testing.assert_allclose(forces, FORCES, atol=0.03)
    later = record(rng, levels=(*FORCES[1:], 8.0))
    late = measure(cell_only(folder, tmp_path, later.time, later.force), out=tmp_path / "late")[0]
    assert any("depths count from there" in text for text in late.warnings)


def test_what_levels_csv_holds_beside_the_speeds_is_kept_and_its_bone_ends_the_tissue(
    folder: Path, tmp_path: Path
):
    lines = (folder / "case.toml").read_text().splitlines()
    there = [lines.index(f"[site.{name}]") for name in ("load_cell", "swe_images")]
    case = tmp_path / "case"
    shutil.copytree(folder, case)
    (case / "case.toml").write_text("\n".join(lines[: there[0]] + lines[there[1] :]) + "\n")
    header = "force_n,depth_mm,hold_s,probe_travel_mm,skin_bone_mm,skin_mm,fat_mm"
    rows = ["0,0,20,0,20,1.5,6", "2,1,20,1.2,19,1.5,5.8", "4,2,20,2.4,,,", "6,3,20,3.6,17,1.4,5.5"]
    (case / "p1.csv").write_text("\n".join([header, *rows]) + "\n")
    result = measure(Case.open(case), out=tmp_path / "out")[0]
    made, known = read_levels(result.path("levels")), read_levels(case / "p1.csv")
    for name in ("force", "depth", "hold", "probe_travel", "skin_bone"):
        np.testing.assert_array_equal(getattr(made, name), getattr(known, name))
    np.testing.assert_array_equal(made.layer("fat"), known.layer("fat"))
    deepest = [read_map(result.folder / "swe" / f"level_{k:02d}.csv").depth.max() for k in range(4)]
    assert deepest == pytest.approx([18.5, 17.5, 23.5, 15.5])


@pytest.mark.slow
def test_half_a_table_is_not_written_into_the_case(folder: Path, tmp_path: Path):
    text = (folder / "case.toml").read_text()
    case = without(folder, tmp_path / "case", "-")
    (case.folder / "case.toml").write_text(
        text[: text.index("[site.load_cell]")] + text[text.index("[site.swe") :]
    )
    with pytest.raises(MeasurementError, match="no force_n and no depth_mm"):
        measure(Case.open(case.folder), out=tmp_path / "a", write=True)
    assert not (case.folder / "p1.csv").exists()


@pytest.mark.slow
def test_layers_of_the_images_become_columns_that_add_up_to_the_bone(folder: Path, tmp_path: Path):
    case = without(folder, tmp_path / "case", "-")
    toml = (folder / "case.toml").read_text()
    layers = "skin_mm = [1.5, 1.4, 1.4, 1.3]\nfat_mm = [7.0, 6.4, 6.0, 5.7]\n"
    (tmp_path / "case" / "case.toml").write_text(toml.replace("[site.b_mode]\n", "[site.b_mode]\n" + layers))
    result = measure(Case.open(case.folder), out=tmp_path / "a")[0]
    levels = read_levels(result.path("levels"))
    assert list(levels.layers) == ["skin", "fat", "muscle"]
    np.testing.assert_allclose(levels.layers["fat"], [7.0, 6.4, 6.0, 5.7])
    np.testing.assert_allclose(sum(levels.layers.values()), levels.skin_bone, atol=1e-4)
    assert any(text.startswith("fat 7.00 to 5.70 mm") for text in result.summary)
    alone = "fat_mm = 7.0\n"
    (tmp_path / "case" / "case.toml").write_text(toml.replace("[site.b_mode]\n", "[site.b_mode]\n" + alone))
    with pytest.raises(MeasurementError, match="fat_mm is stated without skin_mm"):
        measure(Case.open(case.folder), out=tmp_path / "b")


def test_cycles_are_found_in_the_record(folder: Path, tmp_path: Path, rng):
    """Loaded, unloaded and loaded again: levels.csv has the columns cycle and phase."""
    trace = record(rng, levels=(0.0, 2.0, 4.0, 6.0, 4.0, 2.0, 0.0, 2.0, 4.0, 6.0))
    case = cell_only(folder, tmp_path, trace.time, trace.force)
    found = measure(case, out=tmp_path / "out")[0]
    rows = found.path("levels").read_text().splitlines()
    assert rows[0].startswith("cycle,phase,force_n")
    assert [row.split(",")[0] for row in rows[1:]] == ["1"] * 6 + ["2"] * 4
    assert [row.split(",")[1] for row in rows[1:]] == ["load"] * 4 + ["unload"] * 2 + ["load"] * 4
    assert found.data["cycles"] == 2
    assert any("2 cycles found, 2 holds during unloading" in each for each in found.summary)
    assert not any("overshot" in each for each in found.warnings)
