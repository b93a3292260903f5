"""Maps at their own resolution: what a model shows in them, and what they err by."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from limbcli.diagnosis.data import noise_parts as model_noise
from limbcli.diagnosis.data.noise_parts import MapNoise
from limbcli.diagnosis.data.rows import SiteRows
from limbcli.diagnosis.data.windows import Windows
from limbcli.diagnosis.explanations import search
from limbcli.diagnosis.explanations.forward_model import Data, Fitted
from limbcli.diagnosis.explanations.noise import Noise, independent
from limbcli.effects import effect
from limbcli.effects.stiffness_places import Places
from limbcli.measurement.map_noise import PixelNoise
from tests.stages.block_case import block_model

SMALL = Windows(-8.0, 8.0, 2.0, 10.0, 4, 2, whole_is_known=True)


def mapped(levels, parts) -> SiteRows:
    """These parts, numbered from 0, of the map of every level."""
    return SiteRows.of("map", np.repeat(list(levels), len(parts)), np.tile(list(parts), len(levels)) + 1)


def cells(rng: np.random.Generator, n: int = 6000) -> np.ndarray:
    """Middles of cells that fill the region's surroundings, at rest."""
    return rng.uniform([-20.0, -8.0, -24.0], [20.0, 8.0, 0.0], (n, 3))


def seen(rest: np.ndarray, stretch: float, *, depth: float):
    F = np.broadcast_to(np.diag([stretch**-0.5, stretch**-0.5, stretch]), (len(rest), 3, 3))
    return SMALL.seen(block_model(), rest @ F[0].T - [0, 0, depth], rest, F, depth=depth)


def test_what_is_even_in_space_is_shown_exactly(rng):
    rest = cells(rng)
    shown = seen(rest, 0.8, depth=3.0)
    at = shown.averages(rest)
    x, z = SMALL.pixels
    assert at[:, 0] == pytest.approx(x * 0.8**0.5, abs=1e-6)
    assert at[:, 2] == pytest.approx(-z / 0.8, abs=1e-6)
    places = shown.places.at
    assert np.einsum("q,pqd->pd", shown.weight, places) == pytest.approx(at, abs=1e-6)
    assert shown.weight.sum() == pytest.approx(1.0)


def test_an_inclusion_shows_where_its_tissue_is_and_as_strongly_as_it_is(rng):
    """At rest and squeezed: the parts over it are faster by the root of its ratio, others are not."""
    theta = {"log_inclusion_ratio": np.log(4.0), "inclusion_x_mm": 0.0, "inclusion_depth_mm": 8.0,
             "inclusion_radius_mm": 5.0}  # fmt: skip

    def field(places: Places) -> np.ndarray:
        return effect("inclusion").stiffness(places, theta)

    rest = cells(rng)
    for stretch, below in ((1.0, 8.0), (0.7, 5.6)):
        shown = seen(rest, stretch, depth=0.0)
        at_pixels = shown.with_fields(shown.averages(np.full(len(rest), 2.0)), [field])
        rise = SMALL.log_means_of(at_pixels)[1:] - np.log(2.0)
        x, z = SMALL.middles.T
        away = np.hypot(x * stretch**0.5, (z - below) / stretch)
        assert rise[away < 2.5] == pytest.approx(np.log(2.0), abs=0.12)
        assert np.abs(rise[away > 8.5]).max(initial=0.0) < 0.03


def test_what_another_mesh_changes_in_one_part_alone_is_no_effects_doing(rng):
    """A change that is even over the map comes through, a spike beside bone does not; the mean stays."""
    windows = Windows(-20.0, 20.0, 2.0, 26.0, across=10, down=6)
    x, z = windows.middles.T
    even = 0.02 + 0.001 * x - 0.002 * z
    ln_speed = np.column_stack([np.full(3, 0.3), np.outer([0.0, 1.0, 2.0], even)])
    found = windows.without_spikes(ln_speed)
    inner = (np.abs(x) < 17) & (z > 4) & (z < 24)
    assert found[:, 1:][:, inner] == pytest.approx(ln_speed[:, 1:][:, inner], abs=1e-12)
    assert np.array_equal(found[:, 0], ln_speed[:, 0])
    spiked = ln_speed.copy()
    spiked[2, 1 + 52] += 0.46
    spiked[2, 1 + 27] -= 0.33
    assert np.abs(windows.without_spikes(spiked) - found).max() < 0.01


def test_the_covariance_of_parts_is_that_of_smoothed_pixels(rng):
    """Against 4000 drawn maps of noise."""
    n, smoothing = 4000, 1.3
    pitch = np.arange(-19.5, 20.0), np.arange(2.5, 26.0)
    from scipy.ndimage import gaussian_filter

    noise = gaussian_filter(rng.standard_normal((n, 40, 24)), (0, smoothing, smoothing), mode="wrap")
    noise *= 0.1 / noise.std()
    parts = noise.reshape(n, 10, 4, 6, 4).mean(axis=(2, 4))
    middles = np.array(
        [(a, b) for b in pitch[1].reshape(6, 4).mean(1) for a in pitch[0].reshape(10, 4).mean(1)]
    )
    own = MapNoise(middles, (4.0, 4.0), (1.0, 1.0), PixelNoise(0.1, smoothing, 1.0), np.zeros(2))
    rows = mapped((0, 1), (12, 13, 22))
    found = own.of_pixels(rows, np.full(6, 0.1 / 4.0))
    drawn = [parts[:, 2, 1], parts[:, 3, 1], parts[:, 2, 2]]
    expected = np.cov(np.array(drawn))
    assert found[:3, :3] == pytest.approx(expected, rel=0.12, abs=4e-4)
    assert not found[:3, 3:].any()  # levels are read one after the other
    independent = MapNoise(middles, (4.0, 4.0), (1.0, 1.0), PixelNoise(0.1), np.zeros(2))
    assert independent.of_pixels(rows, np.full(6, 0.025)) == pytest.approx(np.eye(6) * 0.025**2)


def test_a_models_error_grows_with_strain_and_is_nearly_none_at_rest():
    model = MapNoise(SMALL.middles, (4.0, 4.0), (1.0, 1.0), PixelNoise(0.1), np.array([0.0, 0.2, 0.3]))
    rows = mapped(range(3), (0, 1, 7))
    found = np.sqrt(np.diag(model.of_model(rows, 1.0))).reshape(3, 3)
    assert np.all(found[0] < 0.002)  # a twentieth of what a part is read to
    assert np.all(found[2] > 1.4 * found[1])
    assert found[1, 0] > found[1, 2]  # more just below the face
    assert np.linalg.eigvalsh(model.of_model(rows, 1.0)).min() > 0


def test_a_models_error_is_shared_by_neighbours_and_levels():
    """Beside one another by their distance, at the next level by less than all."""
    model = MapNoise(SMALL.middles, (4.0, 4.0), (1.0, 1.0), PixelNoise(0.1), np.array([0.0, 0.2, 0.3]))
    n = len(SMALL.middles)
    found = model.of_model(mapped(range(3), range(n)), 0.5)
    deviation = np.sqrt(np.diag(found))
    alike = found[n:, n:] / np.outer(deviation[n:], deviation[n:])
    near, far = alike[0, 1], alike[0, 3]
    assert 0.9 > near > 1.5 * far > 0
    assert 0.8 < alike[0, n] < 0.95
    whole = model.of_model(mapped((1,), range(n)), 1.0)[0, 0]
    of_level = (model_noise._IN_LEVEL * 0.2**2) ** 2  # of a level's mean, whatever the share
    assert found[n, n] - of_level == pytest.approx(0.25 * (whole - of_level), rel=1e-2)


def test_a_model_errs_most_beside_what_a_map_does_not_show():
    """Four parts side by side in two rows, 4 mm apart; one has no speed at the second level."""
    model = MapNoise(SMALL.middles, (4.0, 4.0), (1.0, 1.0), PixelNoise(0.1), np.array([0.3, 0.3]))
    rows = mapped((0, 1), range(8))
    hole = rows.where((rows.level != 1) | (rows.part != 1))
    shown, beside = (np.sqrt(np.diag(model.of_model(each, 1.0))) for each in (rows, hole))
    assert beside[:8] == pytest.approx(shown[:8]), "as before at the level that has all"
    from_it = np.hypot(*(SMALL.middles[1:] - SMALL.middles[0]).T)
    of_level = model_noise._IN_LEVEL * 0.3**2
    times = np.sqrt((beside[8:] ** 2 - of_level**2) / (shown[9:] ** 2 - of_level**2))
    expected = 1.0 + model_noise._AT_BONE * np.exp(-from_it / model_noise._FROM_BONE_MM)
    assert times == pytest.approx(expected, rel=1e-3)
    assert times.max() > 4.0 > 1.9 > times.min()


def test_an_effects_form_errs_by_its_share_alike_at_neighbouring_levels_and_places():
    """Two parts of an image, 4 mm apart, at two levels; and a force: 15 % and 5 % of what changes."""
    n, level = 6, np.array([0.0, 0.0, 1.0, 1.0, 0.0, 1.0])
    place = np.array([[0.0, 5.0], [4.0, 5.0], [0.0, 5.0], [4.0, 5.0], [np.nan] * 2, [np.nan] * 2])
    noise = Noise((independent("own", np.ones(n), source="repeats"),))
    data = Data(np.zeros(n), ("map",) * 4 + ("force",) * 2, level, noise, place=place)
    without, change = np.full(n, 3.0), np.array([1.0, -2.0, 1.0, -2.0, 10.0, 20.0])
    fitted = Fitted(("tilt",), without + change, np.zeros((n, 0)), (), {}, without=without)
    found = search.form_error(data, fitted)
    assert found is not None
    assert np.sqrt(np.diag(found)) == pytest.approx([0.15, 0.3, 0.15, 0.3, 0.5, 1.0])
    alike = found / np.sqrt(np.outer(np.diag(found), np.diag(found)))
    assert not alike[:4, 4:].any()
    assert alike[4, 5] == pytest.approx(search._ALIKE)
    assert alike[0, 2] == pytest.approx(search._ALIKE_IN_IMAGE)
    assert alike[0, 1] == pytest.approx(np.exp(-0.5))  # as far apart as the error is wide
    assert alike[0, 3] == pytest.approx(alike[0, 1] * alike[0, 2])
    assert search.form_error(data, replace(fitted, without=None)) is None  # no effect, no form
