"""levels.csv and trace.csv: a wrong number is never taken for a right one."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from limbcli.errors import MeasurementError
from limbcli.measurement.indentation import (
    LayerNoise,
    check_levels,
    level_warnings,
    read_levels,
    read_trace,
)

HEADER = "force_n,depth_mm,swe_mean_m_per_s,swe_sd_m_per_s,swe_pixels"
ROWS = ["0,0,1.65,0.2,90", "2,2.1,1.8,0.2,88", "4,3.9,2.0,0.3,85", "6,5.2,2.3,0.3,84"]


def write(folder: Path, header: str = HEADER, rows: list[str] | None = None) -> Path:
    path = folder / "levels.csv"
    path.write_text("\n".join([header, *(ROWS if rows is None else rows)]) + "\n")
    return path


def columns(path: Path, *, force: float = 1.0, depth: float = 1.0, speed: float = 1.0) -> Path:
    """The good table in other units."""
    rows = []
    for row in ROWS:
        cells = [float(each) for each in row.split(",")]
        rows.append(
            f"{cells[0] * force},{cells[1] * depth},{cells[2] * speed},{cells[3] * speed},{cells[4]:.0f}"
        )
    return write(path, rows=rows)


def test_columns_are_read_in_any_order_and_missing_ones_are_nan(tmp_path: Path):
    levels = read_levels(write(tmp_path, "depth_mm,force_n", ["0,0", "1,2", "2,4"]))
    np.testing.assert_array_equal(levels.force, [0, 2, 4])
    np.testing.assert_array_equal(levels.depth, [0, 1, 2])
    assert not levels.has_swe
    assert levels.loading.all()


MODULI = HEADER.replace("m_per_s", "young_kpa")


def test_moduli_as_scanners_show_them_become_the_speeds_they_were_made_from(tmp_path: Path):
    """Speeds that scatter by 15 %, shown as the mean and spread of E = 3 rho v^2."""
    means = np.array([1.65, 1.8, 2.0, 2.3])
    speeds = means[:, None] * (1 + 0.15 * np.random.default_rng(7).standard_normal((4, 20_000)))
    moduli = 3.0 * speeds**2  # kPa
    rows = [f"{force},{depth},{each.mean():.6g},{each.std():.6g},85"
            for force, depth, each in zip((0, 2, 4, 6), (0, 2.1, 3.9, 5.2), moduli, strict=True)]  # fmt: skip
    found = read_levels(write(tmp_path, MODULI, rows))
    np.testing.assert_allclose(found.swe_mean_m_per_s, speeds.mean(axis=1), rtol=1e-3)  # third order of 15 %
    np.testing.assert_allclose(found.swe_sd_m_per_s, speeds.std(axis=1), rtol=0.02)
    without_spread = read_levels(write(tmp_path, MODULI, ["0,0,12,,", "2,2,12,,", "4,4,,,", "6,5,12,,"]))
    np.testing.assert_allclose(without_spread.swe_mean_m_per_s, [2, 2, np.nan, 2])
    assert np.isnan(without_spread.swe_sd_m_per_s).all()


@pytest.mark.parametrize("value", ["-12", "12000"])
def test_a_modulus_that_no_tissue_has_is_refused(tmp_path: Path, value: str):
    with pytest.raises(MeasurementError, match=r"the speed from swe_mean_young_kpa(.|\n)*in Pa or MPa"):
        read_levels(write(tmp_path, MODULI, [f"0,0,{value},3,90", *ROWS[1:]]))


@pytest.mark.parametrize("separator", [";", "\t"])
def test_spreadsheets_with_decimal_commas_are_read(tmp_path: Path, separator: str):
    ours = read_levels(write(tmp_path))

    def as_spreadsheet(line: str) -> str:
        return line.replace(",", separator).replace(".", ",")

    path = write(tmp_path, as_spreadsheet(HEADER), [as_spreadsheet(row) for row in ROWS])
    theirs = read_levels(path)
    for name in ("force", "depth", "swe_mean_m_per_s", "swe_sd_m_per_s", "swe_pixels"):
        np.testing.assert_array_equal(getattr(theirs, name), getattr(ours, name))
    path.write_text(path.read_text().replace("2,1", "2.1"))
    with pytest.raises(MeasurementError, match="'1,65', not a number"):  # which mark is that of decimals?
        read_levels(path)


def test_dashes_for_no_reading_are_told_to_be_left_empty(tmp_path: Path):
    with pytest.raises(MeasurementError, match=r"'---', not a number(.|\n)*leave the cell empty"):
        read_levels(write(tmp_path, rows=[*ROWS[:3], "6,5.2,---,0.3,84"]))


def test_empty_columns_that_a_spreadsheet_leaves_are_none(tmp_path: Path):
    rows = [f"{row},," for row in ROWS]
    levels = read_levels(write(tmp_path, HEADER + ",,", rows))
    np.testing.assert_array_equal(levels.force, [0, 2, 4, 6])
    with pytest.raises(MeasurementError, match="a column without a name"):
        read_levels(write(tmp_path, HEADER + ",,", [*rows[:3], ROWS[3] + ",7,"]))


def test_no_pixels_at_a_level_are_no_reading_but_no_mean_is_of_none(tmp_path: Path):
    header = "force_n,depth_mm,swe_mean_m_per_s,swe_pixels"
    levels = read_levels(write(tmp_path, header, ["0,0,1.6,90", "2,2,1.8,80", "4,3.5,,0", "6,5,2.2,85"]))
    np.testing.assert_array_equal(levels.swe_pixels, [90, 80, np.nan, 85])
    with pytest.raises(MeasurementError, match="swe_pixels is 0"):
        read_levels(write(tmp_path, header, ["0,0,1.6,90", "2,2,1.8,80", "4,3.5,2.0,0", "6,5,2.2,85"]))


def test_unloading_levels_are_told_apart(tmp_path: Path):
    rows = ["0,0,load", "2,1,load", "4,2,load", "2,1.4,unload", "0,0.2,unload"]
    levels = read_levels(write(tmp_path, "force_n,depth_mm,phase", rows))
    np.testing.assert_array_equal(levels.loading, [True, True, True, False, False])


def test_a_phase_may_be_written_in_other_ways(tmp_path: Path):
    rows = ["0,0,LOAD", "2,2.1,Loading", "4,3.9,loading", "2,2.9,Unloading", "0,1,unload"]
    levels = read_levels(write(tmp_path, "force_n,depth_mm,phase", rows))
    assert levels.phase == ("load", "load", "load", "unload", "unload")


@pytest.mark.parametrize(
    ("force", "depth", "expected"),
    [
        (1.0, 0.1, ["15.4 N/mm in cycle 2; no limb .22 times what its shear-wave speed implies. is that st"]),
        (0.1, 1.0, ["0.154 N/mm in cycle 2, which is unusual .0.22 times"]),
        (1.0, 1.0, []),
    ],
)
def test_one_cycle_in_another_unit_is_told(tmp_path: Path, force: float, depth: float, expected: list[str]):
    """The fitted cycle is one of them: 6 N at 3.9 mm, with the speed of 1.65 m/s at rest."""
    first = [(0.0, 0.0), (2.0, 1.5), (6.0, 3.9)]
    rows = [f"1,{f},{d},1.65" for f, d in first] + [f"2,{f * force},{d * depth},1.65" for f, d in first]
    _, problems = check_levels(write(tmp_path, "cycle,force_n,depth_mm,swe_mean_m_per_s", rows))
    found = [each.what for each in problems if "force over depth" in each.what]
    assert len(found) == len(expected)
    for what, pattern in zip(found, expected, strict=True):
        assert re.search(pattern, what)


def test_a_level_that_stands_twice_is_refused_and_one_that_crept_is_not(tmp_path: Path):
    """The same force and depth again; the same force, held deeper."""
    twice = [*ROWS[:2], ROWS[1], *ROWS[2:]]
    with pytest.raises(MeasurementError, match=r"line 3 to 4 is repeated"):
        read_levels(write(tmp_path, rows=twice))
    crept = [*ROWS[:2], "2,2.4,1.8,0.2,88", *ROWS[2:]]
    np.testing.assert_array_equal(read_levels(write(tmp_path, rows=crept)).force, [0, 2, 2, 4, 6])


@pytest.mark.parametrize(
    ("force", "depth", "speed", "expected"),
    [
        (102.0, 1.0, 1.0, "grams"),
        (1.0, 0.1, 1.0, "cm"),
        (0.102, 1.0, 1.0, "kgf"),
        (1.0, 1.0, 100.0, "cm/s"),
        (1.0, 1.0, 10.0, "a modulus in kPa"),
        (1.0, -1.0, 1.0, "depth"),
        (-1.0, 1.0, 1.0, "force"),
    ],
)
def test_wrong_units_and_signs_are_refused(tmp_path: Path, force, depth, speed, expected):
    with pytest.raises(MeasurementError, match="fix: ") as caught:
        read_levels(columns(tmp_path, force=force, depth=depth, speed=speed))
    assert expected in str(caught.value)


@pytest.mark.parametrize(
    ("row", "expected"),
    [
        ("4,abc,2.0,0.3,85", "line 4"),
        ("4,,2.0,0.3,85", "depth_mm is empty"),
        ("4,nan,2.0,0.3,85", "depth_mm is nan"),
        ("4,3_9,2.0,0.3,85", "not a number"),
        ("4,inf,2.0,0.3,85", "depth_mm is inf"),
        ('"4,0",3.9,2.0,0.3,85', "not a number"),
        ("4,3.9,2.0,0.3", "4 cells"),
        ("2,2.1,1.8,0.2,88", "repeated"),
        ("0.2,3.9,2.0,0.3,85", "decreases while the depth increases"),
        ("4,-30,2.0,0.3,85", "depth_mm is -30"),
    ],
)
def test_wrong_row_is_named_with_its_line(tmp_path: Path, row: str, expected: str):
    with pytest.raises(MeasurementError, match=r"levels\.csv, line") as caught:
        read_levels(write(tmp_path, rows=[*ROWS[:2], row, ROWS[3]]))
    assert expected in str(caught.value)


@pytest.mark.parametrize(
    ("header", "expected"),
    [
        (HEADER.replace("force_n", "force_N"), "did you mean 'force_n'"),
        (HEADER.replace("depth_mm", "depth_cm"), "did you mean 'depth_mm'? Then convert the values"),
        (HEADER.replace("swe_mean_m_per_s", "swe_mean_kpa"), "'swe_mean_young_kpa'? It holds E = 3 mu, not"),
        (HEADER.replace("swe_sd_m_per_s", "swe_sd_young_kpa"), "two figures of one reading"),
        (HEADER.replace("swe_mean_m_per_s,swe_sd_m_per_s", "hold_s,swe_sd_young_kpa"), "without swe_mean_y"),
        (HEADER.replace("force_n,", ""), "its name includes the unit (N)"),
        (HEADER.replace("swe_pixels", "depth_mm"), "appears twice"),
        (HEADER.replace(",", ";"), "the row has 1 cells, the header 5"),
        (f"Patient 3; site p1\n\n{HEADER}", "the first line, 'Patient 3; site p1', is not a header"),
    ],
)
def test_wrong_header_is_named(tmp_path: Path, header: str, expected: str):
    with pytest.raises(MeasurementError) as caught:
        read_levels(write(tmp_path, header=header))
    assert expected in str(caught.value)


def test_a_workbook_is_named(tmp_path: Path):
    path = tmp_path / "levels.csv"
    path.write_bytes(b"PK\x03\x04\x14\x00\xff\xfe")
    with pytest.raises(MeasurementError, match="not UTF-8 text but an Excel workbook"):
        read_levels(path)


@pytest.mark.parametrize(
    ("rows", "expected"), [([], "no rows"), (ROWS[:1], "one level"), (ROWS[:2], "2 levels")]
)
def test_too_few_levels_are_refused(tmp_path: Path, rows: list[str], expected: str):
    with pytest.raises(MeasurementError, match=expected):
        read_levels(write(tmp_path, rows=rows))


def test_a_quotation_mark_that_is_never_closed_is_named_with_its_line(tmp_path: Path):
    path = tmp_path / "levels.csv"
    path.write_text('force_n,depth_mm\n0,0\n2,"1\n' + "3,2\n" * 40000)
    levels, (found,) = check_levels(path)
    assert levels is None
    assert "line 3" in found.where
    assert "quotation mark" in found.fix


@pytest.mark.parametrize("content", [b"", b"\xff\xfe\x00\x01", b"a\x00b"])
def test_file_that_is_no_table_is_refused(tmp_path: Path, content: bytes):
    path = tmp_path / "levels.csv"
    path.write_bytes(content)
    with pytest.raises(MeasurementError, match="fix: "):
        read_levels(path)


def test_missing_speed_at_level_0_is_a_warning(tmp_path: Path):
    levels, problems = check_levels(write(tmp_path, rows=["0,0,,,", *ROWS[1:]]))
    assert levels is not None
    assert {each.severity for each in problems} == {"warning"}
    assert any("level 0 has no shear-wave speed" in each.what for each in problems)


def test_trace_needs_growing_time_and_all_axes(tmp_path: Path):
    path = tmp_path / "trace.csv"
    path.write_text("time_s,force_n,accel_x_g\n0,0,0\n0.02,0.1,0\n0.01,0.1,0\n")
    with pytest.raises(MeasurementError) as caught:
        read_trace(path)
    assert "does not increase" in str(caught.value)
    assert "accel_y_g, accel_z_g is missing" in str(caught.value)
    path.write_text("time_s,force_n\n0,0\n0.02,0.1\n")
    np.testing.assert_array_equal(read_trace(path).time, [0, 0.02])


def test_a_speed_of_zero_is_refused_and_not_divided_by(tmp_path: Path):
    path = write(tmp_path, rows=["0,0,0,0.2,90", *ROWS[1:]])
    with pytest.raises(MeasurementError, match="swe_mean_m_per_s is 0;"):
        read_levels(path)


def test_speeds_in_cm_per_s_are_not_taken_for_a_soft_limb(tmp_path: Path):
    """Where the speed itself is impossible, nothing is concluded from it."""
    _, problems = check_levels(columns(tmp_path, speed=100.0))
    assert all("swe_" in each.what for each in problems if each.severity == "error")


def test_a_modulus_in_the_column_of_speeds_is_doubted(tmp_path: Path):
    rows = [f"{2 * k},{2.0 * k},{(2.1 + 0.2 * k) ** 2},," for k in range(4)]
    assert any("modulus" in text for text in level_warnings(write(tmp_path, rows=rows)))
    assert not level_warnings(write(tmp_path))


def test_a_probe_that_the_tissue_would_pull_was_not_tared(tmp_path: Path):
    def is_reported(zero: float) -> bool:
        rows = [f"{zero + 2 * k},{k}" for k in range(4)]
        warnings = level_warnings(write(tmp_path, "force_n,depth_mm", rows))
        return any("tissue does not pull" in each for each in warnings)

    assert is_reported(-2.5)
    assert not is_reported(-0.3)


def test_a_force_that_falls_a_little_while_the_depth_grows_is_doubted(tmp_path: Path):
    def warnings(force: str) -> list[str]:
        rows = ["0,0", "2,2.1", f"{force},4", "6,5.5"]
        found = level_warnings(write(tmp_path, "force_n,depth_mm", rows))
        return [text for text in found if "decreases" in text]

    assert "decreases by 0.5 N" in warnings("1.5")[0]
    assert not warnings("1.9"), "within the noise of a reading"


@pytest.mark.parametrize(
    ("rows", "expected"),
    [
        (["0,0,load", "2,2,load", "4,1.8,load", "6,4,load"], "the depth shrinks by 0.2 mm"),
        (["0,0,load", "2,2,load", "1.8,1.5,load", "6,4,load"], "the depth shrinks by 0.5 mm with the force"),
        (["0,0,load", "2,2,load", "6,4,load", "4,4.3,unload", "2,4.5,unload"], "the depth grows by 0.2 mm"),
    ],
)
def test_depths_that_do_not_grow_are_told(tmp_path: Path, rows: list[str], expected: str):
    levels, problems = check_levels(write(tmp_path, "force_n,depth_mm,phase", rows))
    assert levels is not None
    assert any(expected in each.what and each.severity == "warning" for each in problems)


@pytest.mark.parametrize("first", ["2,1.6,1.7,0.2,90", "0.4,1.4,1.7,0.2,90"])
def test_a_measurement_without_a_level_0_is_told(tmp_path: Path, first: str):
    warnings = level_warnings(write(tmp_path, rows=[first, *ROWS[2:], "8,6,2.5,0.3,80"]))
    assert any("there is no level 0" in each for each in warnings)
    assert not any("level 0" in each for each in level_warnings(write(tmp_path)))


@pytest.mark.parametrize(("first", "is_reported"), [("3.5,0,1.7,0.2,90", True), ("2,1.6,1.7,0.2,90", False)])
def test_a_force_at_no_depth_may_be_a_missing_tare(tmp_path: Path, first: str, is_reported: bool):
    rows = [first, "5.5,2,1.9,0.2,90", "7.5,4,2.1,0.2,90", "9.5,6,2.3,0.2,90"]
    problems = check_levels(write(tmp_path, rows=rows))[1]
    (uncertainty,) = [each for each in problems if "there is no level 0" in each.what]
    assert ("if the load cell was not tared, subtract its reading in air" in uncertainty.fix) == is_reported


@pytest.mark.parametrize(
    ("force", "moved", "given"),
    [(0.0, 0.8, True), (0.0, -0.8, True), (0.0, 0.3, False), (0.5, 0.8, False), (0.0, 0.0, False)],
)
def test_a_level_0_that_stands_elsewhere_than_at_0_mm_is_told(
    tmp_path: Path, force: float, moved: float, given: bool
):
    """All depths would be off by it; a force that already presses explains some depth."""
    rows = [f"{force},{moved}", *(f"{2 * k},{depth + moved}" for k, depth in ((1, 2.1), (2, 3.9), (3, 5.2)))]
    warnings = level_warnings(write(tmp_path, "force_n,depth_mm", rows), noise=LayerNoise(0.2, 0.3))
    found = [each for each in warnings if "depth_mm counts from level 0" in each]
    assert bool(found) == given
    assert not given or f"subtract {moved:.3g} mm from every depth" in found[0]


def test_depths_of_another_origin_than_first_touch_are_refused(tmp_path: Path):
    """Such as the reading of a guide: 20 mm at 0 N."""
    rows = [f"{2 * k},{20 + depth}" for k, depth in enumerate((0.0, 2.1, 3.9, 5.2))]
    _, problems = check_levels(write(tmp_path, "force_n,depth_mm", rows))
    (error,) = [each for each in problems if each.severity == "error"]
    assert error.what == "level 0 is at 20 mm and 0 N, but depth_mm counts from level 0"
    assert "subtract 20 mm" in error.fix


@pytest.mark.parametrize("depths", [(12.2, 9.0, 5.0, 0.0), (47.9, 42.9, 40.6, 39.2), (3.0, 4.0, 2.0, 1.0)])
def test_depths_that_run_backwards_are_refused(tmp_path: Path, depths):
    rows = [f"{2 * k},{depth}" for k, depth in enumerate(depths)]
    _, problems = check_levels(write(tmp_path, "force_n,depth_mm", rows))
    errors = [each for each in problems if each.severity == "error"]
    assert [each.what for each in errors] == [
        "depth_mm decreases while force_n increases (lines 2 to 5, phase load)"
    ]
    assert "a distance instead of a decrease" in errors[0].fix


def distances(tmp_path: Path, rows: list[str], **noise: float) -> list[str]:
    """What is said of depth against distance: severity and words."""
    path = write(tmp_path, "force_n,depth_mm,skin_bone_mm", rows)
    found = check_levels(path, noise=LayerNoise(**noise))[1]
    return [f"{each.severity}: {each.what}" for each in found if "skin_bone_mm" in each.what]


def test_a_depth_beyond_the_bone_is_refused(tmp_path: Path):
    first_only = ["0,0,4.8", "2,2,", "4,4.8,", "6,5.5,"]
    (reported,) = distances(tmp_path, first_only)
    assert reported.startswith("error: depth_mm is 4.8, but the bone lies 4.8 mm below the skin")
    assert not distances(tmp_path, [first_only[0].replace("4.8", "5.6"), *first_only[1:]])
    assert not distances(tmp_path, ["2,3,5", "4,5,3", "6,7,1"]), "5 mm are left at a depth of 3 mm"


def test_a_distance_that_contradicts_the_depth_is_doubted(tmp_path: Path):
    swapped = ["0,0,48", "5,2,43", "7.3,4.1,40.7", "8.7,5.9,39.3", "10.4,8,37.6"]
    (reported,) = distances(tmp_path, swapped)
    assert reported.startswith("warning: skin_bone_mm and depth_mm contradict each other at 4 levels")
    assert not distances(tmp_path, swapped, depth=1.0), "within four deviations"
    (reported,) = distances(tmp_path, ["0,0,48", "2,5,42.6", "4,7.3,41.2", "6,8.7,36"])
    assert "contradict each other at one level: the distance has become 12 mm shorter" in reported
    assert not distances(tmp_path, ["2,3,45", "4,5,43.2", "6,7,40.9"]), "depths that begin elsewhere"
    assert not distances(tmp_path, ["0,0,", "2,3,45", "4,5,43.2", "6,7,40.9"]), "not seen at level 0"
