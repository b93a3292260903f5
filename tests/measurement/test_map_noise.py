"""The correlation of a map's noise, found in maps whose noise is known."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from limbcli.measurement.elastography import SweMap
from limbcli.measurement.map_noise import PixelNoise, pixel_noise


def maps(rng: np.random.Generator, smoothing: float, *, n: int = 10) -> list[SweMap]:
    """A tissue that stiffens evenly, a factor a level, and noise of 10 % smoothed over so many mm."""
    x, z = np.meshgrid(np.arange(-20.0, 21.0), np.arange(2.0, 26.0), indexing="ij")
    found = []
    for k in range(n):
        noise = rng.standard_normal(x.shape)
        if smoothing:
            noise = gaussian_filter(noise, smoothing, mode="wrap")
        even = 0.6 + 0.02 * k + 0.002 * k * z + 0.3 * np.exp(-((x + 7) ** 2 + (z - 12) ** 2) / 40)
        speed = np.exp(even + 0.1 * noise / noise.std() + 0.05 * rng.standard_normal())
        found.append(SweMap(x.ravel(), z.ravel(), speed.ravel()))
    return found


@pytest.mark.parametrize("smoothing", [0.0, 1.27, 2.0])
def test_noise_is_found_whatever_the_tissue(rng, smoothing):
    found = pixel_noise(maps(rng, smoothing), usual=0.3)
    assert found.deviation == pytest.approx(0.1, rel=0.06)
    if smoothing:
        assert found.smoothing == pytest.approx(smoothing, rel=0.15)
        assert found.share > 0.9
    else:
        assert found.share < 0.05


def test_tissue_whose_pattern_bends_from_level_to_level_is_no_smooth_noise(rng):
    """Over the pixels of a part it would count many times: 1 % in common adds a seventh to the variance of
    the mean of 16 pixels with 10 % each."""
    x, z = np.meshgrid(np.arange(-20.0, 21.0), np.arange(2.0, 26.0), indexing="ij")
    shape = np.exp(-((x + 7) ** 2 + (z - 10) ** 2) / 300)
    bent = []
    for k in range(10):
        speed = np.exp(0.6 + 0.014 * k**2 * shape + 0.1 * rng.standard_normal(x.shape))
        bent.append(SweMap(x.ravel(), z.ravel(), speed.ravel()))
    found = pixel_noise(bent, usual=0.3)
    assert (found.smoothing, found.share) == (0.0, 0.0)
    assert found.deviation == pytest.approx(0.1, rel=0.06)


@pytest.mark.parametrize("smoothing", [0.0, 1.27])
def test_maps_with_pixels_missing_everywhere_tell_it_too(rng, smoothing):
    sparse = []
    for each in maps(rng, smoothing, n=5):
        there = rng.random(len(each)) > 0.1
        sparse.append(SweMap(each.lateral[there], each.depth[there], each.speed_m_per_s[there]))
    found = pixel_noise(sparse, usual=0.3)
    assert found.deviation == pytest.approx(0.1, rel=0.06)
    assert found.smoothing == pytest.approx(smoothing, rel=0.15)
    assert (found.share > 0.9) == (smoothing > 0)


@pytest.mark.parametrize("pitch", [0.3, 1.0])
def test_maps_with_holes_and_fine_pixels_tell_it_too(rng, pitch):
    x, z = np.meshgrid(np.arange(-12.0, 12.0, pitch), np.arange(2.0, 26.0, pitch), indexing="ij")
    holed = []
    for _ in range(10):
        noise = gaussian_filter(rng.standard_normal(x.shape), 1.27 / pitch, mode="wrap")
        seen = np.hypot(x - 2, z - 22) > 4
        speed = np.exp(0.6 + 0.1 * noise / noise.std())
        holed.append(SweMap(x[seen], z[seen], speed[seen]))
    assert pixel_noise(holed, usual=0.3).smoothing == pytest.approx(1.27, rel=0.15)


def test_too_few_maps_tell_nothing(rng):
    assert pixel_noise(maps(rng, 1.3, n=2), usual=0.3) == PixelNoise(0.3)
