"""The stiffness field: closed forms, limits, calibration against known fields, bad readings."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from limbcli.errors import FitError, MeshError
from limbcli.measurement.elastography import SweMap
from limbcli.measurement.map_noise import PixelNoise
from limbcli.stiffness_field import (
    PRIORS,
    Draws,
    HypothesisGrid,
    Interval,
    MapReading,
    SiteReading,
    contradictions,
    held_out,
    limb_coordinates,
    map_reading,
    stiffness_field,
    write_draws,
)
from limbcli.stiffness_field.expectation import normal_readings
from limbcli.stiffness_field.field import quantile
from limbcli.stiffness_field.kernel import Features, Lengths, correlation
from limbcli.stiffness_field.likelihood import Bound, Known
from tests.stiffness_field import synthetic as limb

ONE = HypothesisGrid((80.0,), (1.0,), (1.0,), (0.3,), (0.0,))  # a single hypothesis: closed forms hold


@pytest.fixture(scope="module")
def coordinates():
    return limb.coordinates()


@pytest.fixture(scope="module")
def points():
    return limb.tissue_points(150, np.random.default_rng(7))


def turned(angle: float = 0.7) -> np.ndarray:
    """A rigid motion: about an oblique axis, and away."""
    u = np.array([1.0, 2.0, 3.0]) / np.sqrt(14.0)
    cross = np.array([[0, -u[2], u[1]], [u[2], 0, -u[0]], [-u[1], u[0], 0]])
    out = np.eye(4)
    out[:3, :3] = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    out[:3, 3] = [30.0, -200.0, 55.0]
    return out


# ---------------------------------------------------------------- coordinates


def test_depth_runs_from_skin_to_bone_and_height_from_the_distal_end(coordinates):
    line = np.array([[0.0, y, 100.0] for y in (43.9, 30.0, 15.0, 1.5)])  # posterior: skin at 45.6, bone at 1
    found = coordinates.places(line)
    np.testing.assert_allclose(found.height, 100.0, atol=1e-6)
    skin, bone = limb.skin_radius(np.array(100.0)), -12 + limb.BONE
    expected = (skin - line[:, 1]) / (skin - bone)
    np.testing.assert_allclose(found.depth, expected, atol=0.04)  # samples 2 mm apart, a slanted skin
    np.testing.assert_allclose(np.abs(found.angle), np.pi, atol=0.1)


def test_angle_is_zero_anterior_and_a_quarter_turn_to_the_left(coordinates):
    found = coordinates.places(np.array([[0.0, -35, 120], [35, 0, 120], [-35, 0, 120]]))
    np.testing.assert_allclose(np.degrees(found.angle), [0, 90, -90], atol=3)


def test_without_bone_the_depth_is_one_on_the_centre_line():
    bare = limb.coordinates(bones=())
    found = bare.places(np.array([[0.0, 0, 110], [20, 0, 110]]))
    assert found.depth[0] > 0.98
    assert 0.4 < found.depth[1] < 0.7


def test_coordinates_do_not_jump_at_the_centre_line_nor_behind():
    bare = limb.coordinates(bones=())
    across = np.column_stack([np.linspace(-3, 3, 61), np.full(61, 0.01), np.full(61, 110.0)])
    assert np.abs(np.diff(bare.places(across).around, axis=0)).max() < 0.05
    angle = np.radians(np.linspace(170, 190, 41))
    behind = np.column_stack([30 * np.sin(angle), -30 * np.cos(angle), np.full(41, 110.0)])
    assert np.abs(np.diff(bare.places(behind).around, axis=0)).max() < 0.02


def test_the_cap_of_the_proximal_cut_is_no_skin(coordinates):
    found = coordinates.places(np.array([[0.0, 10, limb.LENGTH - 1.0]]))
    assert found.depth[0] > 0.5


@pytest.mark.parametrize("axis", [np.zeros(3), np.array([np.nan, 0, 1])])
def test_an_axis_without_direction_is_refused(axis):
    with pytest.raises(MeshError, match="no direction"):
        limb_coordinates(limb.SKIN, limb.BONES, axis)


# ---------------------------------------------------------------- closed forms


def test_one_site_gives_the_closed_form(coordinates, points):
    region = limb.region(110, 60)
    field = stiffness_field(coordinates, [limb.site("p1", region, 0.012, 0.1)], grid=ONE)
    at, here = coordinates.places(points), coordinates.places(region)
    lengths, prior = Lengths(80.0, 1.0, 1.0), PRIORS["c"]
    own = 0.09 * correlation(here, here, lengths).mean() + prior.deviation**2 + 0.1**2
    cross = 0.09 * correlation(at, here, lengths).mean(axis=1) + prior.deviation**2
    mean = prior.mean + cross / own * (np.log(0.012) - prior.mean)
    spread = np.sqrt(0.09 + prior.deviation**2 - cross**2 / own)
    found = field.at(points)
    np.testing.assert_allclose(np.log(found.c), mean, atol=1e-6)
    np.testing.assert_allclose(np.log(found.c_low), mean - 1.96 * spread, atol=2e-4)
    np.testing.assert_allclose(np.log(found.c_high), mean + 1.96 * spread, atol=2e-4)


def test_without_sites_the_field_is_the_prior_and_all_of_it_assumed(coordinates, points):
    found = stiffness_field(coordinates, [], grid=ONE).at(points)
    reach = 1.96 * np.hypot(0.3, PRIORS["c"].deviation)
    np.testing.assert_allclose(found.c, 0.008, rtol=1e-9)
    np.testing.assert_allclose(np.log(found.c_high / found.c), reach, rtol=1e-4)
    assert set(found.label) == {"assumed"}
    assert np.isinf(found.distance).all()
    assert (found.ratio > 0.999).all()


def test_far_from_every_site_the_field_is_the_persons_mean(coordinates):
    short = HypothesisGrid((6.0,), (0.3,), (0.5,), (0.3,), (0.0,))
    sites = [limb.site(f"p{k}", limb.region(60, a), 0.016, 0.02) for k, a in enumerate((0, 130, 240))]
    found = stiffness_field(coordinates, sites, grid=short).at(np.array([[0.0, 30, 200]]))
    assert found.label[0] == "assumed"
    assert found.c[0] == pytest.approx(0.016, rel=0.05)  # not the population's 0.008
    assert np.log(found.c_high[0] / found.c[0]) > 0.98 * 1.96 * 0.3


def test_two_sites_far_apart_each_hold_their_own_value(coordinates):
    short = HypothesisGrid((15.0,), (0.4,), (2.0,), (0.6,), (0.0,))
    regions = [limb.region(50, 0), limb.region(170, 180)]
    sites = [limb.site(n, r, c, 0.02) for n, r, c in zip("ab", regions, (0.005, 0.015), strict=True)]
    field = stiffness_field(coordinates, sites, grid=short)
    for each in sites:
        mean, _ = field.mean_over("c", each.points)
        assert np.exp(mean[0]) == pytest.approx(each.values["c"].value, rel=0.02)


def test_a_bound_is_no_number(coordinates):
    """ "Above 0.02" raises the field, and leaves it open upwards; "above 0.001" says nothing."""
    region = limb.region(110, 60)
    prior = stiffness_field(coordinates, [], grid=ONE).at(region)
    told = SiteReading("p1", region, {"c": Interval(0.5, 0.02, None)})
    found = stiffness_field(coordinates, [told], grid=ONE).at(region)
    assert (found.c > 1.5 * prior.c).all()
    assert (found.c < 0.05).all()  # the value 0.5 on the bound is not believed
    idle = SiteReading("p1", region, {"c": Interval(0.5, 0.0005, None)})
    found = stiffness_field(coordinates, [idle], grid=ONE).at(region)
    np.testing.assert_allclose(found.c, prior.c, rtol=0.01)
    assert set(found.label) == {"assumed"}


# ---------------------------------------------------------------- likelihoods


@pytest.mark.parametrize("likelihood", [Known(0.5, 0.2, 0.6), Bound(1.0, 1.0), Bound(-0.5, -1.0)])
@pytest.mark.parametrize(("mean", "variance"), [(0.0, 0.5), (2.0, 0.1), (-1.0, 0.3)])
def test_the_approximation_has_the_moments_of_the_integral(likelihood, mean, variance):
    z = np.linspace(-12, 12, 40001)
    if isinstance(likelihood, Known):
        side = np.where(z < likelihood.mode, likelihood.below, likelihood.above)
        shape = np.exp(-0.5 * ((z - likelihood.mode) / side) ** 2)
    else:
        shape = norm.cdf(likelihood.side * (z - likelihood.at) / 0.18 - 1.0496)
    w = norm.pdf(z, mean, variance**0.5) * shape
    size = np.trapezoid(w, z)
    first = np.trapezoid(w * z, z) / size
    second = np.trapezoid(w * (z - first) ** 2, z) / size
    found = normal_readings([likelihood], np.array([mean]), np.array([[variance]]))
    precision = 1 / variance + 1 / found.variance[0]
    got = (mean / variance + found.values[0] / found.variance[0]) / precision
    assert (got, 1 / precision) == (pytest.approx(first, abs=1e-6), pytest.approx(second, abs=1e-6))
    evidence = found.log_size + norm.logpdf(found.values[0], mean, np.sqrt(variance + found.variance[0]))
    assert evidence == pytest.approx(np.log(size), abs=1e-6)


def test_an_asymmetric_interval_pulls_less_on_its_long_side(coordinates):
    region = limb.region(110, 60)
    wide_up = SiteReading("p1", region, {"c": Interval(0.01, 0.009, 0.03)})
    even = SiteReading("p1", region, {"c": Interval(0.01, 0.009, 0.01 / 0.9)})
    up, same = (stiffness_field(coordinates, [each], grid=ONE).at(region) for each in (wide_up, even))
    assert (up.c > 1.05 * same.c).all()
    assert (up.c_high > 1.3 * same.c_high).all()


def test_quantile_of_a_mixture_is_where_its_distribution_says():
    mean, variance = np.array([[0.0], [2.0], [5.0]]), np.array([[0.01], [1.0], [0.04]])
    shares = np.array([0.2, 0.5, 0.3])
    for q in (0.025, 0.4, 0.975):
        x = quantile(q, mean, variance, shares)
        below = shares @ norm.cdf((x - mean) / np.sqrt(variance))
        assert below[0] == pytest.approx(q, abs=1e-4)


# ---------------------------------------------------------------- invariance


def test_the_field_moves_with_the_limb_and_names_do_not_matter(coordinates, points):
    _, sites = limb.measured("smooth", points, np.random.default_rng(3))
    move = turned()
    skin, bones = limb.SKIN.moved(move), [each.moved(move) for each in limb.BONES]
    other = limb_coordinates(skin, bones, move[:3, :3] @ limb.AXIS)

    def moved(x):
        return x @ move[:3, :3].T + move[:3, 3]

    renamed = [SiteReading(f"q{9 - k}", moved(s.points), s.values) for k, s in enumerate(sites)][::-1]
    a = stiffness_field(coordinates, sites).at(points)
    b = stiffness_field(other, renamed).at(moved(points))
    np.testing.assert_allclose(b.c, a.c, rtol=2e-3)  # the sections' middles depend on where they are taken
    np.testing.assert_allclose(b.c_low, a.c_low, rtol=5e-3)


def test_points_may_come_in_any_order_and_in_any_number(coordinates, points):
    _, sites = limb.measured("waves", points, np.random.default_rng(3))
    field = stiffness_field(coordinates, sites)
    order = np.random.default_rng(1).permutation(len(points))
    np.testing.assert_allclose(field.at(points[order]).c, field.at(points).c[order], rtol=1e-9)
    draw = Draws(field).draw(4)
    np.testing.assert_allclose(draw.at(points[order[:20]]).c, draw.at(points).c[order[:20]], rtol=1e-9)
    again = Draws(stiffness_field(coordinates, sites), n=9).draw(4)
    np.testing.assert_array_equal(again.at(points).m, draw.at(points).m)


# ---------------------------------------------------------------- calibration


def test_an_even_m_says_nothing_of_how_much_c_varies(coordinates, points):
    """Sites whose m and f_kappa are all alike leave the interval of a varying c as it is without them."""
    alike = {"m": Interval(3.0, 2.5, 3.6), "f_kappa": Interval(20.0, 16.0, 25.0)}
    values = (0.006, 0.015, 0.009, 0.022, 0.007, 0.018, 0.011, 0.025)
    regions = [limb.region(*each) for each in limb.EIGHT]
    fields = [
        stiffness_field(
            coordinates,
            [
                limb.site(f"p{k}", where, c, 0.1, **more)
                for k, (where, c) in enumerate(zip(regions, values, strict=True))
            ],
        ).at(points[:40])
        for more in ({}, alike)
    ]
    np.testing.assert_allclose(fields[1].c_low, fields[0].c_low, rtol=1e-6)
    np.testing.assert_allclose(fields[1].c_high, fields[0].c_high, rtol=1e-6)


@pytest.mark.slow
def test_the_interval_holds_the_truth_as_often_as_said(coordinates):
    """Fields of five other kinds, eight sites with noise: 90 to 99 % of the points inside, and the sites left
    out as often as said."""
    inside: dict[str, list[float]] = {kind: [] for kind in limb.KINDS}
    tested = []
    for seed in range(60):
        rng, kind = np.random.default_rng([7, seed]), limb.KINDS[seed % len(limb.KINDS)]
        points = limb.tissue_points(80, rng)
        truth, sites = limb.measured(kind, points, rng)
        field = stiffness_field(coordinates, sites)
        found = field.at(points)
        inside[kind].append(float(np.mean((np.exp(truth) > found.c_low) & (np.exp(truth) < found.c_high))))
        if seed < 10:
            tested += [each.inside for each in held_out(field).sites]
    shares = {kind: float(np.mean(each)) for kind, each in inside.items()}
    assert 0.90 < np.mean(list(shares.values())) < 0.99, shares
    assert min(shares.values()) > 0.85, shares
    assert 0.90 < np.mean(tested) <= 0.99


@pytest.mark.slow
def test_of_fields_drawn_from_the_prior_itself_95_in_100_points_are_inside(coordinates):
    """Draws of the field without sites are the truth: the interval must be neither wider nor narrower."""
    prior = Draws(stiffness_field(coordinates, []), seed=11, n=80)
    regions = [limb.region(*each) for each in limb.EIGHT]
    inside = []
    for k in range(prior.n):
        rng, truth = np.random.default_rng([5, k]), prior.draw(k)
        points = limb.tissue_points(60, rng)
        own = 0.1 * rng.standard_normal(8) + truth.part.hypotheses[0].own_error * rng.standard_normal(8)
        means = [truth.logs(coordinates.places(each))[:, 0].mean() for each in regions]
        c = np.exp(np.array(means) + own)
        sites = [
            limb.site(f"p{j}", each, float(value), 0.1)
            for j, (each, value) in enumerate(zip(regions, c, strict=True))
        ]
        found, known = stiffness_field(coordinates, sites).at(points), truth.at(points).c
        inside.append(np.mean((known > found.c_low) & (known < found.c_high)))
    assert 0.92 < np.mean(inside) < 0.975


# ---------------------------------------------------------------- draws


@pytest.mark.slow
def test_draws_have_the_mean_spread_and_correlation_of_the_posterior(coordinates):
    region = limb.region(110, 60)
    one = limb.site("p1", region, 0.012, 0.15, m=Interval(4.0, 4.0 / 1.4, 4.0 * 1.4))
    reading = SiteReading("p1", region, one.values, {("c", "m"): -0.8})
    field = stiffness_field(coordinates, [reading], grid=ONE)
    draws = Draws(field, n=600)
    at = np.vstack([region[:3], [[0.0, 30, 200]]])
    logs = np.array([draws.draw(k).logs(coordinates.places(at)) for k in range(600)])
    found = field.at(at)
    np.testing.assert_allclose(logs[:, :, 0].mean(axis=0), np.log(found.c), atol=0.06)
    spread = np.log(found.c_high / found.c_low) / (2 * 1.96)
    np.testing.assert_allclose(logs[:, :, 0].std(axis=0), spread, rtol=0.12)  # 600 draws: 3 % each
    mean_c = np.array([draws.draw(k).logs(coordinates.places(region)).mean(axis=0) for k in range(600)])
    rho = np.corrcoef(mean_c[:, 0], mean_c[:, 1])[0, 1]
    assert -0.88 < rho < -0.65


def test_features_approximate_the_kernel(coordinates, points):
    lengths = Lengths(80.0, 1.0, 1.0)
    places = coordinates.places(points[:40])
    values = Features.drawn(20000, lengths, np.random.default_rng(7)).at(places)
    np.testing.assert_allclose(values @ values.T, correlation(places, places, lengths), atol=0.03)


def test_fifty_draws_are_a_table(coordinates, points, tmp_path):
    _, sites = limb.measured("smooth", points, np.random.default_rng(3))
    rows = Draws(stiffness_field(coordinates, sites), n=5).table(points[:20])
    write_draws(tmp_path / "draws.csv", rows)
    lines = (tmp_path / "draws.csv").read_text(encoding="utf-8").splitlines()
    assert len(lines) == 6
    assert lines[0].startswith("draw,c_mean_kpa,m_mean,f_kappa_mean,c_p0_kpa")
    assert 1.0 < rows[0]["c_mean_kpa"] < 60.0


def test_a_draw_that_does_not_exist_is_refused(coordinates):
    with pytest.raises(FitError, match="no draw 50"):
        Draws(stiffness_field(coordinates, [], grid=ONE)).draw(50)


# ---------------------------------------------------------------- maps, contradictions, bad readings


def test_the_common_error_of_a_map_does_not_shrink_with_its_pixels(coordinates):
    region = np.repeat(limb.region(110, 60), 4, axis=0) + np.random.default_rng(1).normal(0, 1, (60, 3))
    log_c, noise = np.full(60, np.log(0.012)), 1e-4 * np.eye(60)
    field = stiffness_field(coordinates, [], [MapReading("p1", region, log_c, noise, 0.2)], grid=ONE)
    found = field.at(region[:5])
    spread = np.log(found.c_high / found.c_low) / (2 * 1.96)
    assert ((spread > 0.17) & (spread < 0.25)).all()


def test_a_map_of_unknown_gain_says_only_how_c_varies(coordinates):
    low, high = limb.region(60, 60)[6:9], limb.region(160, 60)[6:9]
    points = np.concatenate([low, high])
    log_c = np.log(np.r_[np.full(3, 0.02), np.full(3, 0.04)])
    field = stiffness_field(
        coordinates, [], [MapReading("p1", points, log_c, 1e-4 * np.eye(6), None)], grid=ONE
    )
    found = field.at(points)
    assert found.c[3:].mean() / found.c[:3].mean() == pytest.approx(2.0, rel=0.1)
    assert found.c_low[0] < 0.008 < found.c_high[0]


def test_a_map_becomes_squares_with_the_stiffness_of_its_speeds():
    x, z = (each.ravel() for each in np.meshgrid(np.arange(-20, 20.0), np.arange(1.0, 30)))
    speed = np.where(z < 15, 1.5, 2.5)
    swe = SweMap(x, z, speed)
    free = map_reading("p1", swe, np.eye(4), PixelNoise(0.1), gain_deviation=0.1)
    tied = map_reading("p1", swe, np.eye(4), PixelNoise(0.1, 2.0, 0.9), gain_deviation=0.1)
    assert len(free.points) <= 60
    pixels = (2 * 0.1) ** 2 / np.diag(free.covariance)  # ln c has twice the noise of ln speed
    assert pixels.sum() == pytest.approx(len(swe))
    shallow = free.points[:, 2] > -8
    np.testing.assert_allclose(np.exp(free.log_c[shallow]), 2e-6 * 1000 * 1.5**2, rtol=1e-9)  # 2 rho v^2
    assert (np.diag(tied.covariance) > 3 * np.diag(free.covariance)).all()
    assert np.linalg.eigvalsh(tied.covariance).min() > 0


def test_two_sites_of_one_place_that_contradict_each_other_widen_the_interval(coordinates):
    region = limb.region(110, 60)
    at_odds = [limb.site("a", region, 0.006, 0.05), limb.site("b", region, 0.012, 0.05)]
    alike = [limb.site("a", region, 0.008, 0.05), limb.site("b", region, 0.009, 0.05)]
    field, other = stiffness_field(coordinates, at_odds), stiffness_field(coordinates, alike)
    wide, narrow = (np.log(each.at(region).c_high / each.at(region).c_low) for each in (field, other))
    assert (wide > narrow).all()
    assert contradictions(other) == []
    (words,) = contradictions(field)
    assert "a and b lie at one place, and their c differ by a factor of 2" in words


@pytest.mark.parametrize(
    ("reading", "match"),
    [
        ({"c": Interval(8.0, 7.0, 9.0)}, "soft tissue has"),  # kPa for MPa
        ({"c": Interval(-0.008, None, None)}, "not a positive number"),
        ({"c": Interval(float("nan"), 0.007, 0.009)}, "not a positive number"),
        ({"c": Interval(0.008, 0.009, 0.007)}, "runs from"),
        ({"k": Interval(1.0, 0.9, 1.1)}, "no parameter of the field"),
    ],
)
def test_impossible_readings_are_refused_with_the_site(coordinates, reading, match):
    with pytest.raises(FitError, match=match) as caught:
        stiffness_field(coordinates, [SiteReading("p1", limb.region(110, 60), reading)])
    assert "p1" in str(caught.value)


@pytest.mark.parametrize(
    "rho", [{("c", "m"): 1.0}, {("c", "m"): 0.9, ("c", "f_kappa"): 0.9, ("m", "f_kappa"): -0.9}]
)
def test_correlations_that_cannot_be_are_refused(coordinates, rho):
    one = limb.site("p1", limb.region(110, 60), 0.01, 0.1)
    with pytest.raises(FitError, match="no three quantities"):
        stiffness_field(coordinates, [SiteReading("p1", one.points, one.values, rho)])


def test_a_site_given_twice_is_refused(coordinates):
    one = limb.site("p1", limb.region(110, 60), 0.01, 0.1)
    with pytest.raises(FitError, match="two readings"):
        stiffness_field(coordinates, [one, one])


def test_held_out_skips_what_cannot_be_tested_and_says_why(coordinates):
    one = limb.site("p1", limb.region(110, 60), 0.01, 0.1)
    other = SiteReading("p2", limb.region(60, 60), {"c": Interval(0.01, 0.004, None)})
    found = held_out(stiffness_field(coordinates, [one, other], grid=ONE), ONE)
    assert "two ends" in found.skipped["p2"]
    assert found.sites[0].site == "p1"
    alone = held_out(stiffness_field(coordinates, [one], grid=ONE), ONE)
    assert alone.skipped == {"p1": "no other site has c"}
    assert "it takes two" in alone.words
