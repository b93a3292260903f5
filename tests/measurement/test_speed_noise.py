"""The uncertainty of a mean speed: stated noise, spread over pixels, their number, scatter of the levels."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from limbcli.case import StatedNoise
from limbcli.errors import MeasurementError
from limbcli.fitting.options import FitOptions
from limbcli.measurement.indentation import check_levels, read_levels
from limbcli.measurement.layer_checks import LayerNoise
from limbcli.measurement.speed_noise import SpeedNoise, mean_speed_deviation
from limbcli.stages.fit import initial_stiffness

SPEEDS = (2.06, 2.2, 2.19, 2.3, 2.6, 2.9, 2.7, 2.85)


def levels_file(
    folder: Path, *, speeds: tuple[float, ...] = SPEEDS, sd: float | str = 0.2, pixels: float | str = 598
) -> Path:
    path = folder / "levels.csv"
    rows = [f"{2 * k},{1.5 * k},{speed},{sd},{pixels}" for k, speed in enumerate(speeds)]
    path.write_text("\n".join(["force_n,depth_mm,swe_mean_m_per_s,swe_sd_m_per_s,swe_pixels", *rows]))
    return path


def told(path: Path) -> list[str]:
    return [each.what for each in check_levels(path)[1]]


def first(path: Path, noise: SpeedNoise = SpeedNoise()) -> float:
    return float(mean_speed_deviation(read_levels(path), noise)[0])


def test_an_agreeing_spread_leaves_the_stated_noise(tmp_path: Path):
    path = levels_file(tmp_path)
    assert first(path) == pytest.approx(np.hypot(0.05, 0.1 / np.sqrt(598)))
    assert told(path) == []


def test_a_larger_spread_rules_and_is_told(tmp_path: Path):
    path = levels_file(tmp_path, sd=1.5, pixels=30)
    assert first(path) == pytest.approx(np.hypot(0.05, 1.5 / 2.06 / np.sqrt(30)))
    (what,) = told(path)
    assert "up to 73% of the mean at 8 levels, 7.3 times swe_pixel_fraction" in what


def test_the_fit_widens_c_by_the_spread(tmp_path: Path):
    site = SimpleNamespace(noise=StatedNoise(), density_kg_per_m3=1000.0, name="p1")
    usual, wide = (
        initial_stiffness(read_levels(levels_file(tmp_path, sd=sd, pixels=30)), site, FitOptions())[0]  # type: ignore[arg-type]
        for sd in (0.2, 1.5)
    )
    assert wide.log_deviation == pytest.approx(2 * np.hypot(0.05, 1.5 / 2.06 / np.sqrt(30)))
    assert wide.log_deviation > 2.5 * usual.log_deviation


@pytest.mark.parametrize("noise", [SpeedNoise(), SpeedNoise(level=0.0)])
def test_a_missing_count_never_makes_a_wide_spread_exact(tmp_path: Path, noise: SpeedNoise):
    assert first(levels_file(tmp_path, sd=1.5, pixels=""), noise) > 0.7


def test_few_pixels_widen(tmp_path: Path):
    assert first(levels_file(tmp_path, sd="", pixels=1)) == pytest.approx(np.hypot(0.05, 0.1))


@pytest.mark.parametrize(
    ("sd", "pixels", "words"),
    [(0, 598, "is 0 at 8 levels"), (0.2, 1, "for a single pixel"), (0.02, 598, "times swe_pixel_fraction")],
)
def test_contradictions_are_told_and_the_stated_noise_rules(
    tmp_path: Path, sd: float, pixels: int, words: str
):
    path = levels_file(tmp_path, sd=sd, pixels=pixels)
    assert any(words in each for each in told(path))
    assert first(path) >= np.hypot(0.05, 0.1 / np.sqrt(pixels)) - 1e-12


@pytest.mark.parametrize(("sd", "pixels", "words"), [(10, 598, "at most 4.7"), (0.2, 1.5, "is whole")])
def test_impossible_figures_are_refused(tmp_path: Path, sd: float, pixels: float, words: str):
    with pytest.raises(MeasurementError, match=words):
        read_levels(levels_file(tmp_path, sd=sd, pixels=pixels))


@pytest.mark.parametrize(("k", "speed"), [(0, 5.0), (3, 12.0), (7, 12.0)])
def test_a_level_off_the_others_is_told_and_widens(tmp_path: Path, k: int, speed: float):
    speeds = tuple(speed if i == k else v for i, v in enumerate(SPEEDS))
    path = levels_file(tmp_path, speeds=speeds, sd="")
    found = told(path)
    assert any(f"swe_mean_m_per_s is {speed:g}, " in each and "times above what" in each for each in found)
    assert any("scatter by" in each for each in found)
    assert first(path) > 0.2


@pytest.mark.slow
def test_scatter_within_the_stated_noise_is_left(tmp_path: Path):
    """Of 200 tables with the stated noise, few are told to scatter more."""
    random = np.random.default_rng(7)
    smooth = np.linspace(2.0, 3.0, 10)
    n = 0
    for _ in range(200):
        speeds = tuple(np.round(smooth * np.exp(0.05 * random.standard_normal(10)), 3))
        n += any(
            "scatter" in each or "other levels" in each for each in told(levels_file(tmp_path, speeds=speeds))
        )
    assert n <= 4


def test_the_noise_that_the_case_states_is_what_is_compared(tmp_path: Path):
    path = levels_file(tmp_path, sd=0.9)
    stated = LayerNoise(speed=SpeedNoise(pixel=0.5))
    assert told(path)
    assert not check_levels(path, noise=stated)[1]
