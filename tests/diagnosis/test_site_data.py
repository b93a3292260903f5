"""The stacked measurement: channels, noise, parts of the scanner's window."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from limbcli.case import StatedNoise
from limbcli.diagnosis.data.held_forces import HeldForces
from limbcli.diagnosis.data.noise_parts import KnownErrors, ModelError, depth_slopes
from limbcli.diagnosis.data.rows import SiteReadings, deepest
from limbcli.diagnosis.data.site_data import site_data
from limbcli.diagnosis.data.windows import Windows
from limbcli.diagnosis.explanations.noise import LinearFit
from limbcli.diagnosis.explanations.residuals import roughness
from limbcli.diagnosis.forward_model.predictions import Predictions
from limbcli.diagnosis.forward_model.surrogate import AtPoints, SiteCurves
from limbcli.effects import effect
from limbcli.effects.curves import Curves
from limbcli.effects.reading import Protocol, Reading, read
from limbcli.measurement.elastography import SweMap
from limbcli.measurement.indentation import Levels
from limbcli.numbers.whitening import Whitener

N = 6


def levels(**changes) -> Levels:
    nan = np.full(N, np.nan)
    values = {
        "force": 2.0 * np.arange(N), "depth": 1.5 * np.arange(N), "swe_mean_m_per_s": nan,
        "swe_sd_m_per_s": nan,
        "swe_pixels": nan, "phase": ("load",) * N, "hold": nan, "probe_travel": nan, "skin_bone": nan,
        "path": Path("levels.csv"), **changes,
    }  # fmt: skip
    return Levels(**values)


def grid_map(speed) -> SweMap:
    lateral, depth = every_mm()
    return SweMap(lateral, depth, np.broadcast_to(speed, lateral.shape).astype(float))


MAPPED = Windows(across=10, down=6, whole_is_known=True)


def every_mm() -> tuple[np.ndarray, np.ndarray]:
    """Pixels 40 mm wide, from 2 to 25 mm below the face."""
    x, z = np.meshgrid(np.arange(-19.5, 20.0), np.arange(2.5, 25.0))
    return x.ravel(), z.ravel()


def test_parts_of_a_map_are_about_four_millimetres_wide_and_share_it_evenly():
    lateral, depth = every_mm()
    swe = SweMap(lateral, depth, np.exp(0.01 * depth))
    windows = Windows.of_maps([swe])
    means, counts = windows.log_means(swe)
    assert (windows.left, windows.right, windows.top, windows.bottom) == (-20.0, 20.0, 2.0, 25.0)
    assert (windows.across, windows.down) == (10, 6)
    assert counts[0] == len(lateral) == counts[1:].sum()
    assert means[1] == pytest.approx(means[10])
    assert means[1] < means[11] < means[51]
    assert len(windows.names()) == len(means) == len(windows.depths) == 61


@pytest.mark.parametrize("pitch", [0.8, 1.5, 2.5, 3.0])
def test_parts_of_a_coarse_map_have_the_pixels_that_its_grid_has_there(pitch):
    """Some parts have four pixels, others two or one: none is missing; one that has a third of its own is."""
    x, z = (each.ravel() for each in np.meshgrid(np.arange(-20, 20.1, pitch), np.arange(2, 25.1, pitch)))
    windows = Windows.of_maps([SweMap(x, z, np.full(len(x), 2.0))])
    means, counts = windows.log_means(SweMap(x, z, np.full(len(x), 2.0)))
    assert np.isfinite(means).all()
    part = windows.part_of(x, z)
    fullest = int(np.argmax(counts[1:]))
    there = part != fullest
    there[np.flatnonzero(~there)[: counts[1:].max() // 3]] = True
    rest = windows.log_means(SweMap(x[there], z[there], np.full(there.sum(), 2.0)))[0]
    assert np.flatnonzero(np.isnan(rest[1:])).tolist() == [fullest]


@pytest.mark.parametrize(
    ("lateral", "depth"),
    [(1.3 * np.arange(-8, 9), 2.0 * np.arange(1, 8)), (1.6 * np.arange(15) - 20.0, 2.5 * np.arange(1, 20)),
     (1.2 * np.arange(-9, 10), 2.5 * np.arange(14))],
)  # fmt: skip
def test_no_part_of_a_whole_map_is_lost_where_pixels_lie_on_a_border_or_begin_at_the_face(lateral, depth):
    """Nor does it matter on which side of the border rounding puts them: mirrored it is the same."""
    x, z = (each.ravel() for each in np.meshgrid(lateral, depth))
    for sign in (1.0, -1.0):
        swe = SweMap(sign * x, z, np.full(len(x), 2.0))
        assert np.isfinite(Windows.of_maps([swe]).log_means(swe)[0]).all()


@pytest.mark.parametrize(("rows", "there"), [(4, True), (3, True), (2, False), (1, False)])
def test_parts_of_which_bone_hides_half_count_for_nothing(rows, there):
    """As the probe goes in, the map ends sooner: no pixel anywhere of the rows in the bone."""
    x, z = (each.ravel() for each in np.meshgrid(np.arange(-20, 20.1), np.arange(2, 26)))
    windows = Windows.of_maps([SweMap(x, z, np.full(len(x), 2.0))])
    kept = z < 22 + rows
    found = windows.log_means(SweMap(x[kept], z[kept], np.full(kept.sum(), 2.0)))[0]
    deepest = found[1 + windows.across * (windows.down - 1) :]
    assert np.isfinite(deepest).all() if there else np.isnan(deepest).all()
    assert np.isfinite(found[1 : 1 + windows.across * (windows.down - 1)]).all()


def test_a_level_of_whose_map_nothing_was_read_has_no_parts(recwarn):
    nothing = SweMap(np.zeros(0), np.zeros(0), np.zeros(0))
    maps = [nothing if k == 2 else grid_map(2.0) for k in range(N)]
    data = site_data("p1", SiteReadings(levels(), StatedNoise(), windows=Windows.of_maps(maps), maps=maps))
    assert set(data.rows.level[data.rows.among("map")].tolist()) == {k for k in range(N) if k != 2}
    assert not recwarn


def test_pixels_outside_the_region_belong_to_no_part():
    windows = Windows(-10.0, 10.0, 2.0, 12.0, 2, 2)
    outside = SweMap(np.array([-11.0, 10.5, 0.0, 5.0]), np.array([5.0, 5.0, 13.0, 5.0]), np.full(4, 3.0))
    assert windows.part_of(outside.lateral, outside.depth).tolist() == [-1, -1, -1, 1]


def test_a_mean_whose_region_is_not_known_lies_between_that_of_a_narrow_and_of_a_wide_one():
    windows = Windows.usual(53.0)
    x, _ = windows.pixels
    found = windows.log_means_of(np.where(np.abs(x) < 12.0, 3.0, 2.0))[None]
    narrow, wide = np.log(3.0), np.log(0.6 * 3.0 + 0.4 * 2.0)
    assert found[0, 0] == pytest.approx((narrow + wide) / 2)
    assert windows.width_uncertainty(found) == pytest.approx([(narrow - wide) / 2])


def test_speeds_that_a_line_takes_below_zero_are_not_known():
    windows = Windows(-10.0, 10.0, 2.0, 12.0, 2, 2)
    speed = np.full((4, 4), 2.0)
    speed[1], speed[2, 0] = -0.1, -5.0
    nothing = np.full(16, np.nan)
    found, none = windows.log_means_of(np.array([speed.ravel(), nothing]))
    assert np.isnan(found[2])
    assert found[3] == pytest.approx(np.log(2.0))
    assert np.isnan(none).all()


def test_channels_are_those_measured():
    plain = site_data("p1", SiteReadings(levels(), StatedNoise(), windows=Windows()))
    assert plain.channels == ("force",)
    assert len(plain.rows) == N - 1  # level 0 is 0 N at 0 mm by definition
    full = levels(probe_travel=2.0 * np.arange(N), skin_bone=30.0 - 1.5 * np.arange(N), hold=np.full(N, 20.0))
    windows = np.array([[[0, 4], [8, 12]], [[8, 12], [20, 24]]])
    held = HeldForces(np.linspace(0, 9, 40), windows, np.array([0.1, 0.05]), 0.01**2 * np.eye(2))
    rich = site_data(
        "p1", SiteReadings(full, StatedNoise(), windows=MAPPED, maps=[grid_map(2.0)] * N, held=held)
    )
    assert set(rich.channels) == {"force", "map", "travel", "skin-bone", "swe", "hold"}
    assert sum(row.channel == "map" for row in rich.rows) == 60 * N
    assert rich.data.y[[row.channel == "map" for row in rich.rows]] == pytest.approx(np.log(2.0))
    assert {"speed maps, deep middle", "speed maps, first third of the levels"} <= set(rich.data.groups)
    assert np.linalg.eigvalsh(rich.data.noise.covariance).min() > 0


def test_a_force_that_falls_less_late_in_a_hold_than_early_is_no_scatter():
    """Each hold gives several ratios, and only those at one place in it go on evenly from hold to hold."""
    first = np.array([[[0, 2], [2, 4]], [[2, 4], [4, 8]]])
    windows = np.concatenate([first + 20 * k for k in range(8)])
    falls = np.tile([0.2, 0.1], 8)
    held = HeldForces(np.linspace(0, 9, 160), windows, falls, 0.01**2 * np.eye(16))
    data = site_data("p1", SiteReadings(levels(), StatedNoise(), windows=Windows(), held=held)).data
    whiten = Whitener.of(data.noise.covariance)
    off = np.where([channel == "hold" for channel in data.channel], data.y, 0.0)
    state = LinearFit.of(whiten(off), np.zeros((len(data), 0)))
    found = roughness(state, whiten, series=data.all_series(), order=data.order)
    assert found.ratio == pytest.approx(0.0, abs=1e-9)


def test_assumed_noise_is_recognised_and_known_noise_is_not():
    assert site_data(
        "p1", SiteReadings(levels(), StatedNoise(source="assumed"), windows=Windows())
    ).data.noise.is_assumed
    assert not site_data(
        "p1", SiteReadings(levels(), StatedNoise(source="spec"), windows=Windows())
    ).data.noise.is_assumed


def test_a_part_that_the_model_does_not_always_show_is_left_out():
    usable = np.ones(60, dtype=bool)
    usable[3] = False
    maps = [grid_map(2.0)] * N
    data = site_data("p1", SiteReadings(levels(), StatedNoise(), windows=MAPPED, maps=maps, usable=usable))
    used = {(row.level, row.part - 1) for row in data.rows if row.channel == "map"}
    assert used == {(level, part) for level in range(N) for part in range(60) if part != 3}


def test_a_part_that_one_exponents_model_does_not_show_is_continued_there():
    """Its slope there is that at the depths at which it is shown; the other model has it at all depths."""
    depth = np.linspace(0.0, 10.0, 6)
    speeds = np.multiply.outer(depth, np.full(61, 0.02))
    gap = speeds.copy()
    gap[4:, 5] = np.nan
    site = site_data("p1", SiteReadings(levels(), StatedNoise(), windows=MAPPED, maps=[grid_map(2.0)] * N))
    curves = SiteCurves(site, SimpleNamespace(c=0.01), {})
    curves.nodes = {
        m: Curves(depth, depth**1.2, table, MAPPED.depths, 28.0) for m, table in ((4.0, speeds), (8.0, gap))
    }
    found = curves.curves(0.01, 6.0, AtPoints(), {}).log_speed
    assert found == pytest.approx(speeds, abs=1e-12)


@pytest.mark.parametrize("recorded", [False, True])
def test_a_second_relaxing_share_is_fitted_where_holds_are_recorded(recorded):
    windows = np.array([[[0, 4], [8, 12]], [[8, 12], [20, 24]]])
    held = HeldForces(np.linspace(0, 9, 40), windows, np.array([0.1, 0.05]), 0.01**2 * np.eye(2))
    site = site_data(
        "p1", SiteReadings(levels(), StatedNoise(), windows=Windows(), held=held if recorded else None)
    )
    known = {"viscoelasticity": effect("viscoelasticity")}
    slots = Predictions([SiteCurves(site, SimpleNamespace(c=0.01), known)]).slots(("viscoelasticity",))
    second = ["second_relaxing_share"] if recorded else []
    assert [each.name for each in slots] == ["relaxing_share", *second]


def test_pixels_of_a_level_err_together():
    data = site_data("p1", SiteReadings(levels(), StatedNoise(), windows=MAPPED, maps=[grid_map(2.0)] * N))
    covariance = data.data.noise.covariance
    index = {(row.channel, row.level, row.part): k for k, row in enumerate(data.rows)}
    within = covariance[index["map", 2, 1], index["map", 2, 5]]
    across = covariance[index["map", 2, 1], index["map", 3, 5]]
    assert within > across > 0  # the gain of the scanner is common to all levels


def test_model_error_moves_force_and_speed_as_stated():
    log_force, log_speed = np.full(N, 0.05), np.zeros((N, len(Windows().depths)))
    with_error = site_data(
        "p1",
        SiteReadings(levels(), StatedNoise(), windows=Windows()),
        KnownErrors(errors=[ModelError("mesh", log_force, log_speed)]),
    )
    without = site_data("p1", SiteReadings(levels(), StatedNoise(), windows=Windows()))
    added = with_error.data.noise.covariance - without.data.noise.covariance
    assert np.diag(added) == pytest.approx((0.05 * without.data.y) ** 2)


def test_doubt_about_first_touch_moves_every_level_along_the_measured_slope():
    none = np.zeros((N, len(Windows().depths)))
    touch = ModelError("first touch", np.zeros(N), none, depth=0.4)
    with_error = site_data(
        "p1", SiteReadings(levels(), StatedNoise(), windows=Windows()), KnownErrors(errors=[touch])
    )
    without = site_data("p1", SiteReadings(levels(), StatedNoise(), windows=Windows()))
    slope = depth_slopes(with_error.protocol, with_error.rows)
    added = with_error.data.noise.covariance - without.data.noise.covariance
    assert added == pytest.approx(np.outer(0.4 * slope, 0.4 * slope))
    assert np.linalg.matrix_rank(added, tol=1e-9) == 1


def test_doubt_about_the_thickness_moves_levels_by_their_depth():
    none = np.zeros((N, len(Windows().depths)))
    thick = ModelError("thickness", np.zeros(N), none, strain=0.02)
    with_error = site_data(
        "p1", SiteReadings(levels(), StatedNoise(), windows=Windows()), KnownErrors(errors=[thick])
    )
    without = site_data("p1", SiteReadings(levels(), StatedNoise(), windows=Windows()))
    depth = with_error.protocol.depth[with_error.rows.level]
    shift = 0.02 * depth * depth_slopes(with_error.protocol, with_error.rows)
    added = with_error.data.noise.covariance - without.data.noise.covariance
    assert added == pytest.approx(np.outer(shift, shift))


def test_mesh_error_is_alike_at_neighbouring_levels_and_less_so_far_apart():
    mesh = ModelError("mesh", np.full(N, 0.05), np.zeros((N, len(Windows().depths))), correlation=0.8)
    with_error = site_data(
        "p1", SiteReadings(levels(), StatedNoise(), windows=Windows()), KnownErrors(errors=[mesh])
    )
    without = site_data("p1", SiteReadings(levels(), StatedNoise(), windows=Windows()))
    added = with_error.data.noise.covariance - without.data.noise.covariance
    size = 0.05 * without.data.y
    assert added[1, 2] == pytest.approx(0.8 * size[1] * size[2])
    assert added[1, 4] == pytest.approx(0.8**3 * size[1] * size[4])


def test_prediction_is_laid_out_like_the_data():
    depth = np.linspace(0, 10, 6)
    curves = Curves(depth, depth**1.2, np.tile(np.log(np.arange(2.0, 63.0)), (6, 1)), MAPPED.depths, 28.0)
    data = site_data(
        "p1",
        SiteReadings(
            levels(skin_bone=np.full(N, 30.0)), StatedNoise(), windows=MAPPED, maps=[grid_map(2.0)] * N
        ),
    )
    found = data.predict(curves, Reading())
    for row, value in zip(data.rows, found, strict=True):
        if row.channel == "map":
            assert np.exp(value) == pytest.approx(row.part + 2)
        elif row.channel == "skin-bone":
            assert value == 28.0


STEEP = np.linspace(0.0, 6.0, 31)


def steep() -> Curves:
    """A force that doubles every 0.6 mm at the end, as over thin tissue, and speeds that rise with it."""
    speeds = np.column_stack([0.7 + 0.1 * STEEP + 0.02 * STEEP**2] * 10)
    return Curves(STEEP, 0.3 * np.expm1(1.1 * STEEP), speeds, np.zeros(10))


def measured_on_steep(depth_error) -> Levels:
    force = np.linspace(0.0, 26.0, 14)
    depth = np.log1p(force / 0.3) / 1.1
    nan, speed = np.full(14, np.nan), np.exp(0.7 + 0.1 * depth + 0.02 * depth**2)
    return Levels(
        force=force,
        depth=depth + depth_error,
        swe_mean_m_per_s=speed,
        swe_sd_m_per_s=nan,
        swe_pixels=np.full(14, 100.0),
        phase=("load",) * 14,
        hold=nan,
        probe_travel=nan,
        skin_bone=nan,
        path=Path("x"),
    )


@pytest.mark.parametrize("size", [0.3, -0.3, 0.9])
def test_an_error_of_depth_moves_the_data_in_proportion_however_steep_the_curve(size):
    """By the slopes that its noise has: over a curve that bends that much, not those of the curve there."""
    error = size * np.cos(2.0 * np.arange(14)) * (np.arange(14) > 0)
    site = site_data("p1", SiteReadings(measured_on_steep(error), StatedNoise(), windows=Windows()))
    left = site.data.y - site.predict(steep(), Reading())
    levels = np.array([row.level for row in site.rows])
    assert left == pytest.approx(-site.slope * error[levels], rel=0.02, abs=0.02)


def test_an_error_of_depth_moves_maps_by_the_slopes_of_its_noise_where_an_effect_makes_them_steeper():
    """Guided waves near their cut-off: at the depths as they were read, four times that would be left."""
    error = 0.3 * np.random.default_rng(5).standard_normal(14) * (np.arange(14) > 0)
    record, exact, guided = measured_on_steep(error), measured_on_steep(0.0), Reading(guided=0.038)
    speeds = np.repeat(steep().log_speed[:, :1], 61, axis=1)
    curves = Curves(STEEP, steep().force, speeds, MAPPED.depths, 9.0)
    shown = read(curves, Protocol(exact.force, exact.depth, np.zeros(14)), guided).log_speed[:, 0]
    as_read = read(curves, Protocol(record.force, record.depth, np.zeros(14)), guided).log_speed[:, 0]
    slopes = np.repeat((0.1 + 0.04 * exact.depth)[:, None], 60, axis=1)
    maps = [grid_map(each) for each in np.exp(shown)]
    site = site_data(
        "p1", SiteReadings(record, StatedNoise(), windows=MAPPED, maps=maps), KnownErrors(map_slopes=slopes)
    )
    is_map = np.array([row.channel == "map" for row in site.rows])
    at = np.array([row.level for row in site.rows])[is_map]
    allowed = -site.slope[is_map] * error[at]
    left = (site.data.y - site.predict(curves, guided))[is_map]
    assert np.abs(left - allowed).max() < 0.3 * np.abs((shown - as_read)[at] - allowed).max()


def test_an_error_of_the_tissues_speed_shows_several_times_near_the_cut_off_of_guided_waves():
    """d ln(v / sqrt(1 - r)) / d ln v = 1 / (1 - r), r the square of speed over that at the cut-off."""
    record = measured_on_steep(0.0)
    speeds = np.repeat(steep().log_speed[:, :1], 61, axis=1)
    curves = Curves(STEEP, steep().force, speeds, MAPPED.depths, 9.0)
    maps = [grid_map(each) for each in record.swe_mean_m_per_s]
    site = site_data("p1", SiteReadings(record, StatedNoise(), windows=MAPPED, maps=maps))
    found = site.amplification(curves, Reading(guided=0.038))
    level = np.array([row.level for row in site.rows])
    ratio = (1e3 * record.swe_mean_m_per_s / (2 * (9.0 - record.depth))) ** 2 * 0.038e-4
    is_map = site.rows.among("map")
    assert ratio.max() > 0.5
    assert found[is_map] == pytest.approx((1 / (1 - ratio))[level[is_map]], rel=0.02)  # of a smoothed depth
    assert np.all(found[~is_map] == 1.0)
    assert site.amplification(curves, Reading(speed_slope=0.02)) == pytest.approx(np.ones(len(found)))


@pytest.mark.parametrize("reading", [Reading(force_zero=3.0), Reading(preload=1.5), Reading(depth_gain=1.1)])
def test_so_it_does_where_the_reading_is_distorted(reading):
    true = measured_on_steep(0.0)
    depth = true.depth / reading.depth_gain
    if reading.preload:  # force and depth are told from where it rests
        depth = depth - np.log1p(reading.preload / 0.3) / 1.1
    keep = depth > 0.3
    error = (0.3 * np.cos(2.0 * np.arange(14)))[keep][-N:]
    record = levels(
        force=(true.force + reading.force_zero - reading.preload)[keep][-N:], depth=depth[keep][-N:] + error,
        swe_mean_m_per_s=true.swe_mean_m_per_s[keep][-N:], swe_pixels=np.full(N, 100.0),
    )  # fmt: skip
    site = site_data("p1", SiteReadings(record, StatedNoise(), windows=Windows()))
    left = site.data.y - site.predict(steep(), reading)
    at = np.array([row.level for row in site.rows])
    assert left == pytest.approx(-site.slope * error[at], rel=0.02, abs=0.03)


@pytest.mark.parametrize(("as_shown", "expected"), [(False, 24.0 / 1.04), (True, 24.0)])
def test_a_wrong_speed_of_sound_shows_in_the_distance_to_a_bone_that_was_imaged_otherwise(as_shown, expected):
    """Where the bone was put as the ultrasound showed it, model and reading are off alike."""
    z = np.linspace(0.0, 10.0, 11)
    curves = Curves(z, 2.0 * z, np.zeros((11, 0)), np.zeros(0), 24.0)
    bone = np.r_[24.0, np.full(N - 1, np.nan)]
    site = site_data(
        "p1",
        SiteReadings(levels(skin_bone=bone), StatedNoise(), windows=Windows()),
        KnownErrors(bone_as_shown=as_shown),
    )
    at = [row.channel for row in site.rows].index("skin-bone")
    assert site.predict(curves, Reading(depth_gain=1.04))[at] == pytest.approx(expected)


def test_slopes_of_a_steep_curve_are_not_flattened_by_errors_of_depth():
    rng, found = np.random.default_rng(3), []
    for _ in range(40):
        error = 0.3 * rng.standard_normal(14) * (np.arange(14) > 0)
        site = site_data("p1", SiteReadings(measured_on_steep(error), StatedNoise(), windows=Windows()))
        found.append(site.slope[: len(site.protocol) - 1])
    true = 1.1 * (np.linspace(0.0, 26.0, 14)[1:] + 0.3)
    assert np.median(found, axis=0)[3:] == pytest.approx(true[3:], rel=0.25)


def test_deepest_is_of_a_smooth_curve_through_the_readings():
    error = np.zeros(14)
    error[-2] = 0.9
    noisy = measured_on_steep(error)
    found = deepest(Protocol(noisy.force, noisy.depth, noisy.hold))
    assert found == pytest.approx(measured_on_steep(0.0).depth[-1], abs=0.4)
    two = Protocol(noisy.force[-2:], noisy.depth[-2:], noisy.hold[-2:])
    assert deepest(two) == noisy.depth[-2:].max()


def with_travel(travel, **changes):
    return site_data(
        "p1", SiteReadings(levels(probe_travel=travel, **changes), StatedNoise(), windows=Windows())
    )


def travels(site, values) -> np.ndarray:
    return np.array([value for row, value in zip(site.rows, values, strict=True) if row.channel == "travel"])


def test_where_the_scale_of_the_guide_begins_is_no_matter():
    depth = 1.5 * np.arange(N)
    given = depth + 0.1 * 2.0 * np.arange(N)
    at_zero, elsewhere = with_travel(given), with_travel(given + 112.4)
    reading = Reading(compliance=0.1)
    curves = Curves(STEEP, 4.0 / 3.0 * STEEP, np.zeros((31, 10)), np.zeros(10))
    assert elsewhere.data.y == pytest.approx(at_zero.data.y)
    assert elsewhere.data.noise.covariance == pytest.approx(at_zero.data.noise.covariance)
    for site in (at_zero, elsewhere):
        assert travels(site, site.predict(curves, reading)) == pytest.approx(travels(site, site.data.y))


def test_travel_counts_from_the_first_level_that_has_one():
    """What that level's reading, and its depth, err by all others have in common."""
    late = 112.4 + 1.5 * np.arange(N)
    late[:2] = np.nan
    site = with_travel(late, depth=1.5 * np.arange(N) + np.array([0, 0, 0.3, 0, 0, 0]))
    assert [row.level for row in site.rows if row.channel == "travel"] == [3, 4, 5]
    assert travels(site, site.data.y) == pytest.approx([1.5, 3.0, 4.5])
    (common,) = [each for each in site.data.noise.parts if each.name == "measurement: zero of the travel"]
    assert common.covariance.max() == pytest.approx(0.1**2 + 0.3**2)
    curves = Curves(STEEP, 4.0 / 3.0 * STEEP, np.zeros((31, 10)), np.zeros(10))
    assert travels(site, site.predict(curves, Reading())) == pytest.approx([1.2, 2.7, 4.2])


def test_no_travel_has_no_zero():
    site = with_travel(np.full(N, np.nan))
    assert "travel" not in site.channels
    assert "measurement: zero of the travel" not in site.data.noise.names
