"""Shear-wave maps: files, checks, statistics."""

from __future__ import annotations

import numpy as np
import pytest

from limbcli.errors import MeasurementError
from limbcli.measurement import elastography as swe
from limbcli.measurement.elastography import SweMap
from limbcli.measurement.shear_modulus import shear_modulus_from_wave_speed


def square_map(speed=2.0):
    x, z = (each.ravel() for each in np.meshgrid(np.arange(-2.0, 3), np.arange(1.0, 6)))
    return SweMap(x, z, np.full(x.size, speed))


def test_modulus_is_rho_v_squared_in_mpa():
    assert shear_modulus_from_wave_speed(np.array([1.0, 3.0])).tolist() == [0.001, 0.009]
    assert shear_modulus_from_wave_speed(np.array([2.0]), density_kg_per_m3=1060.0)[0] == 0.00424


@pytest.mark.parametrize("bad", [0.0, -1.0, np.nan, np.inf])
def test_impossible_speed_is_refused_with_its_index(bad):
    with pytest.raises(MeasurementError) as caught:
        shear_modulus_from_wave_speed(np.array([2.0, bad]))
    assert caught.value.facts["index"] == 1


def test_map_survives_the_round_trip(tmp_path, rng):
    pixels = square_map()
    written = SweMap(pixels.lateral, pixels.depth, rng.uniform(1, 5, len(pixels)))
    swe.write_map(tmp_path / "level_00.csv", written)
    read = swe.read_map(tmp_path / "level_00.csv")
    assert np.array_equal(read.lateral, written.lateral)
    assert np.array_equal(read.depth, written.depth)
    assert read.speed_m_per_s == pytest.approx(written.speed_m_per_s, abs=5e-5)


FAULTS = {
    "lateral_mm,depth_mm,speed_m_per_s\n0,1,2\n0,1,2.1\n": "more than once",
    "lateral_mm,depth_mm,speed_m_per_s\n0,1,210\n": "speed_m_per_s is 210",
    "lateral_mm,depth_mm,speed_m_per_s\n0,-1,2\n": "depth_mm is -1",
    "lateral_mm,depth_mm,speed_m_per_s\n300,1,2\n": "lateral_mm is 300",
    "lateral_mm,depth_mm,speed_m_per_s\n0,1,0\n": "speed_m_per_s is 0",
    "lateral_mm,depth_mm,speed_m_per_s\n0,1,inf\n": "speed_m_per_s is inf",
    "lateral_mm,depth_mm,speed_m_per_s\nnan,1,2\n": "lateral_mm is nan",
    "lateral_mm,depth_mm,speed_m_per_s\n0,1,\n": "speed_m_per_s is empty",
    "lateral_mm,depth_mm,speed\n0,1,2\n": "'speed'",
    "": "empty",
}


@pytest.mark.parametrize("text", FAULTS)
def test_faulty_map_is_named_with_place_and_fix(tmp_path, text):
    path = tmp_path / "level_00.csv"
    path.write_text(text)
    with pytest.raises(MeasurementError) as caught:
        swe.read_map(path)
    assert FAULTS[text] in str(caught.value)
    assert "level_00.csv" in str(caught.value)
    assert "fix:" in str(caught.value)


def test_missing_and_surplus_maps_are_both_found(tmp_path):
    for level in (0, 2, 5):
        swe.write_map(swe.map_file(tmp_path, level), square_map())
    maps, problems = swe.check_maps(tmp_path, 3)
    assert len(maps) == 2
    assert [each.what for each in problems] == [
        "the map level_01.csv is missing",
        "level_05.csv belongs to no level",
    ]


def test_a_level_at_which_nothing_was_read_is_a_map_of_no_pixels(tmp_path):
    for level, speed in enumerate((2.0, None, 2.2)):
        path = swe.map_file(tmp_path, level)
        if speed is None:
            path.write_text("lateral_mm,depth_mm,speed_m_per_s\n")
        else:
            swe.write_map(path, square_map(speed))
    maps, problems = swe.check_maps(tmp_path, 3)
    assert (list(map(len, maps)), problems) == ([len(square_map()), 0, len(square_map())], [])
    assert not swe.check_mean(maps[1], float("nan"))
    (problem,) = swe.check_mean(maps[1], 2.1)
    assert "no pixel" in problem.what


def test_a_pixel_whose_speed_is_nan_was_not_read(tmp_path):
    path = swe.map_file(tmp_path, 0)
    path.write_text("lateral_mm,depth_mm,speed_m_per_s\n0,1,2.5\n0,2,NaN\n")
    assert swe.read_map(path).speed_m_per_s.tolist() == [2.5]


def test_a_map_of_youngs_modulus_is_one_of_speeds(tmp_path):
    """E = 3 rho v^2: 12 kPa at 2 m/s, 27 kPa at 3 m/s; one figure a pixel, and within the same limits."""
    path = tmp_path / "level_00.csv"
    path.write_text("lateral_mm,depth_mm,young_kpa\n0,5,12\n1,5,NaN\n2,5,27\n")
    found, problems = swe.check_map(path)
    assert not problems
    assert found.speed_m_per_s == pytest.approx([2.0, 3.0])
    assert found.lateral.tolist() == [0.0, 2.0]
    path.write_text("lateral_mm,depth_mm,young_kpa\n0,5,12000\n")
    assert "young_kpa is 12000; possible values are 0.27 to 1200" in swe.check_map(path)[1][0].what
    path.write_text("lateral_mm,depth_mm,young_kpa,speed_m_per_s\n0,5,12,2\n")
    assert "two figures of one reading" in swe.check_map(path)[1][0].what


def test_maps_of_other_names_are_told_how_maps_are_named(tmp_path):
    swe.write_map(tmp_path / "map_0.csv", square_map())
    assert "level_00.csv, level_01.csv, ..." in swe.check_maps(tmp_path)[1][-1].fix


def test_maps_without_any_pixel_are_refused(tmp_path):
    for level in range(2):
        swe.map_file(tmp_path, level).write_text("lateral_mm,depth_mm,speed_m_per_s\n")
    with pytest.raises(MeasurementError, match="no map has any pixels"):
        swe.read_maps(tmp_path, 2)


@pytest.mark.parametrize(("there", "missing"), [((0, 1, 3, 4, 5), ["level_02.csv"]), ((0, 1, 2), [])])
def test_without_a_count_the_names_tell_which_map_is_missing(tmp_path, there, missing):
    for level in there:
        swe.write_map(swe.map_file(tmp_path, level), square_map())
    maps, problems = swe.check_maps(tmp_path)
    assert len(maps) == len(there)
    assert [each.what for each in problems] == [f"the map {name} is missing" for name in missing]


def test_a_number_far_from_the_others_is_no_count_of_levels(tmp_path):
    for level in (0, 1, 20250311):
        swe.write_map(swe.map_file(tmp_path, level), square_map())
    whats = [each.what for each in swe.check_maps(tmp_path)[1]]
    assert whats == ["the map level_02.csv is missing", "level_20250311.csv belongs to no level"]


def test_statistics_of_a_region_of_interest():
    whole = square_map()
    whole = SweMap(whole.lateral, whole.depth, whole.depth.copy())
    part = whole.within(lateral=(-1, 1), depth=(2, 4))
    found = swe.statistics(part)
    assert (found.mean_m_per_s, found.n_pixels) == (3.0, 9)
    assert found.sd_m_per_s == pytest.approx(np.std([2, 3, 4] * 3, ddof=1))
    assert found.quartiles_m_per_s == (2.0, 3.0, 4.0)
    with pytest.raises(MeasurementError, match="no pixels"):
        swe.statistics(whole.within(lateral=(50, 60), depth=(0, 1)))


def test_a_map_wider_than_the_image_under_the_probe_is_refused():
    wide = SweMap(np.linspace(-36.0, 36, 20), np.linspace(2.0, 20, 20), np.full(20, 2.0))
    (problem,) = swe.check_width(wide, 53.0)
    assert "36 mm" in problem.what
    assert "26.5 mm" in problem.what
    assert not swe.check_width(square_map(), 53.0)


def test_a_map_at_odds_with_the_stated_mean_is_doubted():
    (problem,) = swe.check_mean(square_map(4.0), 2.0)
    assert problem.severity == "warning"
    assert "4.00 m/s" in problem.what
    assert not swe.check_mean(square_map(2.2), 2.0)
    for unknown in (float("nan"), 0.0, -2.0):
        assert not swe.check_mean(square_map(), unknown)
