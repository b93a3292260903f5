"""The site's bench on the reduced model: real effects, real readings, no simulation."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from limbcli.diagnosis.data.noise_parts import IN_MAPS, LEAST_IN_MAPS, STRAIN, KnownErrors, ModelError
from limbcli.diagnosis.data.rows import SiteReadings
from limbcli.diagnosis.data.site_data import site_data
from limbcli.diagnosis.explanations import decisions
from limbcli.diagnosis.explanations.laplace import posterior
from limbcli.diagnosis.explanations.search import form_error
from limbcli.diagnosis.explanations.sentences import sentences
from limbcli.diagnosis.explanations.verdict import diagnose
from limbcli.diagnosis.forward_model.changes import logs
from limbcli.diagnosis.forward_model.site_forward_model import SiteForwardModel
from limbcli.diagnosis.forward_model.surrogate import AtPoints, SiteCurves
from limbcli.diagnosis.written_result import candidates_picture, diagnosis_json, gap_picture
from limbcli.effects import effect
from limbcli.effects.depth_zero import TOUCHES
from limbcli.effects.reading import Reading, read
from limbcli.errors import SolveError
from tests.diagnosis import reduced

CANDIDATES = ("force-zero", "depth-zero", "anisotropy", "skin-layer", "swe-time-scale", "swe-guided-wave",
              "viscoelasticity", "poroelasticity", "support-motion")  # fmt: skip


def bench(levels, names=CANDIDATES, errors=(), **more) -> SiteForwardModel:
    simulations = reduced.ReducedBook(reduced.block_model(6, 5, 5), np.linspace(0, 9, 6), **more)
    site = site_data(
        "p1", SiteReadings(levels, reduced.NOISE, windows=simulations.windows), KnownErrors(errors=errors)
    )
    return SiteForwardModel([SiteCurves(site, simulations, {name: effect(name) for name in names})])


def true_simulations():
    return reduced.ReducedBook(reduced.block_model(7, 6, 6), np.linspace(0, 10, 8), spread=1.03)


def levels(rng, ingredients=(), reading=None, **more):
    return reduced.measured(rng, ingredients, reading, simulations=true_simulations(), **more)


def run(measured, **more):
    return diagnose(bench(measured, **more))


@pytest.mark.slow
def test_nothing_missing_is_adequate_and_recovers_the_tissue(rng):
    found = run(levels(rng))
    assert found.verdict == "adequate"
    assert found.base.values["c_kpa"] == pytest.approx(6.5, rel=0.1)
    assert found.base.values["m"] == pytest.approx(4.0, rel=0.25)


@pytest.mark.slow
def test_force_offset_is_named_and_the_tissue_comes_right(rng):
    few = ("force-zero", "depth-zero", "swe-guided-wave")
    found = run(levels(rng, reading=Reading(force_zero=1.0)), names=few)
    assert found.chosen == ("force-zero",)
    assert found.final.values["force_zero_n"] == pytest.approx(1.0, abs=0.2)
    truth = np.log(6.5)
    before, after = np.log(found.base.values["c_kpa"]), np.log(found.final.values["c_kpa"])
    assert abs(after - truth) < abs(before - truth)


@pytest.mark.slow
def test_sizes_of_effects_are_those_of_their_fits_though_nothing_was_found(rng):
    """To first order a preload that has moved c far, and leaves nothing, would be excluded."""
    measured = levels(rng)
    model = bench(measured, names=("preload", "force-zero", "anisotropy"), errors=[of_the_block(measured)])
    found = diagnose(model)
    assert (found.verdict, found.chosen, found.not_evaluated) == ("adequate", (), {})
    assert all(each.posterior is not None for each in found.explanations if len(each.explanation) == 1)
    low, high = found.sizes["force-zero"]["force_zero_n"]
    value = model.fit(("force-zero",), {}).values["force_zero_n"]
    assert low < value < high
    assert 0.5 * (low + high) == pytest.approx(value, abs=0.25 * (high - low))
    assert set(found.sizes) == {"preload", "force-zero", "anisotropy"}


@pytest.mark.parametrize("n_speeds", [1, 3])
def test_speeds_at_a_few_levels_count_and_more_of_them_are_proposed(rng, n_speeds):
    few = levels(rng)
    speeds = np.where(np.arange(14) < n_speeds, few.swe_mean_m_per_s, np.nan)
    model = bench(replace(few, swe_mean_m_per_s=speeds), names=("force-gain", "swe-time-scale"))
    assert sum(row.channel == "swe" for row in model.site.rows) == n_speeds
    fits = [model.fit((), {}), model.fit(("swe-time-scale",), {})]
    assert "wave speeds" in {each.name for each in model.proposals(fits)}
    model = bench(few, names=("force-gain", "swe-time-scale"))
    assert "wave speeds" not in {each.name for each in model.proposals([model.fit((), {})])}


def test_three_levels_with_speeds_can_be_tested(rng):
    found = diagnose(bench(levels(rng, n_levels=3), names=("force-zero", "swe-time-scale")))
    assert found.shrink[0].nu == 3
    assert found.verdict != "untestable"
    assert not found.not_evaluated


def test_nothing_is_said_to_be_seen_where_nothing_was_tested(rng):
    """Three forces and no speed, for c and m: no part and no effect was looked at."""
    few = replace(levels(rng, n_levels=3), swe_mean_m_per_s=np.full(3, np.nan))
    found = diagnose(bench(few, names=("force-zero",)))
    assert found.verdict == "untestable"
    lines = " ".join(sentences(found))
    assert "Where" not in lines
    assert "could not detect" not in lines


@pytest.mark.parametrize("touches", [0.0, 1.0])
def test_depths_off_by_a_constant_are_found_whether_level_0_is_among_them_or_at_first_touch(rng, touches):
    curves, _, protocol = reduced.truth(simulations=true_simulations())
    deeper = protocol.depth + 2.0 * ((np.arange(14) > 0) | (touches == 0.0))
    true = read(curves, replace(protocol, depth=deeper), Reading())
    given = replace(
        levels(rng), force=true.force + 0.1 * rng.standard_normal(14), depth=protocol.depth,
        swe_mean_m_per_s=np.exp(true.log_speed[:, 0] + 0.03 * rng.standard_normal(14)),
    )  # fmt: skip
    model = bench(given, names=("depth-zero",))
    model.fit((), {})
    fitted = model.fit(("depth-zero",), {"depth_zero_mm": 1.0})
    assert fitted.values[TOUCHES] == touches
    assert fitted.values["depth_zero_mm"] == pytest.approx(2.0, abs=0.25)


@pytest.mark.slow
def test_guided_waves_are_named(rng):
    found = run(levels(rng, reading=Reading(guided=1.0)))
    assert ("swe-guided-wave",) in found.confidence_set


@pytest.mark.slow
def test_fibres_are_in_the_set(rng):
    fibres = ((effect("anisotropy"), {"fibre_shear_per_c": 1.5, "fibre_tension_per_c": 0.5}),)
    found = run(levels(rng, fibres))
    assert any("anisotropy" in each for each in found.confidence_set)


@pytest.mark.slow
def test_one_factor_on_all_speeds_stays_ambiguous_and_a_hold_would_tell(rng):
    """Relaxation and another time scale of the waves do the same to these data; a recorded hold does not."""
    found = run(levels(rng, reading=Reading(log_speed_shift=0.35)))
    assert found.verdict == "ambiguous"
    assert {("swe-time-scale",), ("viscoelasticity",)} <= set(found.confidence_set)
    assert found.next_steps[0].name == "hold"
    assert found.next_steps[0].expected_probability > found.next_steps[0].before + 0.15


def test_what_sets_in_late_changes_only_the_levels_from_there_on(rng):
    the_bench = bench(levels(rng), names=("contraction",))
    x = np.array([*np.log([0.0065, 4.0]), 0.5])
    for m in (2.0, 5.0):
        the_bench.sites[0].solve_nodes([m])
    onset = "tensed_after_share_of_levels"
    plain = the_bench.predict(x[:2])
    whole, late = (
        the_bench.predict(x, AtPoints(("contraction",), ({onset: share},))) for share in (0.0, 0.5)
    )
    level = np.array([row.level for row in the_bench.site.rows])
    early = level < 0.5 * len(the_bench.site.protocol)
    assert late[early] == pytest.approx(plain[early], rel=1e-12)
    assert late[~early] == pytest.approx(whole[~early], rel=1e-12)
    assert np.abs(whole[early] / plain[early] - 1).max() > 0.01


def test_a_pair_starts_from_what_was_solved_of_its_parts(rng):
    one = bench(levels(rng), names=("skin-layer", "contraction")).sites[0]
    for m in (2.0, 5.0):
        one.solve_nodes([m])
    points = ({"tensed_after_share_of_levels": 0.0}, {"skin_thickness_mm": 1.5})
    pair = AtPoints(("contraction", "skin-layer"), points)
    theta = {"active_stress_per_c": 1.0, "log_skin_ratio": 3.0}
    before = one.predict(0.0065, 4.0, pair, theta)
    one.repair(4.0, pair.only([1]), {"log_skin_ratio": 3.0})
    one.repair(4.0, pair.only([0]), {"active_stress_per_c": 1.0})
    one.inherit_parts(pair)
    started = one.predict(0.0065, 4.0, pair, theta)
    one.repair(4.0, pair, theta)
    true = one.predict(0.0065, 4.0, pair, theta)
    assert np.abs(started - true).max() < 0.5 * np.abs(before - true).max()


def test_what_a_simulation_mends_goes_with_the_effects_size(rng):
    """Where a large size was simulated, the model without the effect is still the model without it."""
    one = bench(levels(rng), names=("skin-layer",)).sites[0]
    for m in (2.0, 5.0):
        one.solve_nodes([m])
    skin = AtPoints(("skin-layer",), ({"skin_thickness_mm": 1.5},))

    def force(log_ratio):
        return one.curves(0.0065, 4.0, skin, {"log_skin_ratio": log_ratio}).force[1:]

    plain, before = one.curves(0.0065, 4.0, AtPoints(), {}).force[1:], force(3.0)
    one.repair(4.0, skin, {"log_skin_ratio": 3.0})
    simulations = one.simulations.curves(
        4.0, ((effect("skin-layer"), {"log_skin_ratio": 3.0, "skin_thickness_mm": 1.5}),)
    )
    assert force(3.0) / simulations.force[1:] == pytest.approx(0.0065 / one.simulations.c, rel=1e-9)
    mended = np.abs(np.log(force(3.0) / before)).max()
    assert mended > 0.01
    assert np.abs(np.log(force(0.0) / plain)).max() < 0.05 * mended


def test_every_model_that_was_simulated_is_kept_as_it_is(rng):
    """Whatever is simulated after it, further off, and with another m."""
    one = bench(levels(rng), names=("skin-layer",)).sites[0]
    for m in (2.0, 5.0):
        one.solve_nodes([m])
    skin = AtPoints(("skin-layer",), ({"skin_thickness_mm": 1.5},))
    solved = [(4.0, 1.0), (4.0, 3.0), (2.5, 2.0)]
    for m, log_ratio in solved:
        one.repair(m, skin, {"log_skin_ratio": log_ratio})
    for m, log_ratio in solved:
        theta = {"log_skin_ratio": log_ratio}
        true = one.simulations.curves(m, ((effect("skin-layer"), {**theta, **skin.points[0]}),))
        found = one.curves(one.simulations.c, m, skin, theta)
        assert found.force[1:] == pytest.approx(true.force[1:], rel=1e-6)
        shown = np.isfinite(true.log_speed)
        assert found.log_speed[shown] == pytest.approx(true.log_speed[shown], abs=1e-6)


def test_a_fit_that_does_not_stay_ends_at_the_best_that_was_simulated(rng, monkeypatch):
    the_bench = bench(levels(rng), names=("skin-layer",))
    the_bench.fit((), {})
    drafted = the_bench.fit(("skin-layer",), {})
    skin, x, visited = the_bench.model_of(drafted), the_bench.x_of(drafted), []
    wandering = iter([1.1, 4.0, 0.2, 3.0])

    def best_fit(model, start, *, besides=(), **how):
        return 0.0, the_bench.fitted(np.array([*x[:2], next(wandering)]), model)

    def off(at, model):
        visited.append(at[2])
        return np.array([at[2] - 1.0])

    monkeypatch.setattr(the_bench.sites[0], "repair", lambda *model: None)
    monkeypatch.setattr(the_bench, "best", best_fit)
    monkeypatch.setattr(the_bench, "off", off)
    found = the_bench.verified(the_bench.fitted(np.array([*x[:2], 5.0]), skin))
    assert visited == [5.0, 1.1, 4.0, 0.2]
    assert found.values["log_skin_ratio"] == pytest.approx(1.1)


def test_a_fit_keeps_away_from_what_has_no_answer(rng, monkeypatch):
    the_bench = bench(levels(rng), names=("skin-layer",))
    the_bench.fit((), {})
    predict, beyond = the_bench.predict, 0.5
    skin = AtPoints(("skin-layer",), ({"skin_thickness_mm": 1.5},))

    def refused(x, *model):
        if len(x) > 2 and x[2] > beyond:
            raise SolveError("no answer", where="here", fix="none")
        return predict(x, *model)

    monkeypatch.setattr(the_bench, "predict", refused)
    deviance, fitted = the_bench.best(skin, {})
    assert fitted.values["log_skin_ratio"] < beyond
    assert deviance < 1e4
    beyond = -10.0
    with pytest.raises(SolveError, match="no answer"):
        the_bench.best(skin, {})


def test_a_fit_with_one_effect_is_no_worse_than_without_it(rng, monkeypatch):
    """Also where it begins at a large size, whose simulation was a surprise."""
    the_bench = bench(levels(rng), names=("skin-layer",))
    without = the_bench.fit((), {})
    one, skin = the_bench.sites[0], AtPoints(("skin-layer",), ({"skin_thickness_mm": 1.5},))
    solved = one.simulations.curves

    def stiffer(m, ingredients=()):
        found = solved(m, ingredients)
        return replace(found, force=20.0 * found.force) if ingredients else found

    (begun,) = the_bench._ends_of_parts(skin)
    assert np.exp(begun[:2]) == pytest.approx([without.values["c_kpa"] / 1e3, without.values["m"]])
    monkeypatch.setattr(one.simulations, "curves", stiffer)
    one.repair(4.0, skin, {"log_skin_ratio": 4.9})
    deviance, fitted = the_bench.best(skin, {"log_skin_ratio": 4.9})
    off = the_bench.off(the_bench.x_of(without), AtPoints())
    assert deviance <= float(off @ off) + 0.1, fitted.values


@pytest.mark.slow
def test_muscle_that_tenses_from_a_level_on_is_found_there(rng):
    tensed = ((effect("contraction"), {"active_stress_per_c": 1.0}),)
    found = run(levels(rng, tensed, onset=8 / 14), names=("contraction", "depth-zero", "force-zero"))
    assert found.chosen == ("contraction",)
    assert found.final.values["tensed_after_share_of_levels"] == pytest.approx(8 / 14, abs=0.04)


@pytest.mark.slow
def test_what_cannot_be_run_is_said(rng):
    found = run(levels(rng))
    assert "FEBio" in found.not_evaluated["poroelasticity"]
    assert "travel" in found.not_evaluated["support-motion"]
    assert any(line.startswith("Not evaluated:") for line in sentences(found))


@pytest.mark.drawn
@pytest.mark.slow
def test_json_and_pictures(rng, tmp_path):
    the_bench = bench(levels(rng, reading=Reading(force_zero=1.5)))
    found = diagnose(the_bench)
    content = diagnosis_json(found, the_bench.site, the_bench)
    assert content["verdict"] == "named"
    assert content["candidates"][0]["name"] == "force-zero"
    assert content["candidates"][0]["probability"] >= decisions.CREDIBLE
    assert content["candidates"][0]["ln_bayes_factor"] > 3.0
    assert content["probability_of_nothing"] < content["adequate_from_probability"]
    assert content["explanations"][0]["probability"] == max(
        each["probability"] for each in content["explanations"]
    )
    assert [] in [each["explanation"] for each in content["explanations"]]
    assert content["where"][0]["name"] == content["left"][0]["name"] == "whole"
    assert content["where"][0]["p_adjusted"] < content["left"][0]["p_adjusted"]
    json.dumps(content, allow_nan=False)
    assert content["shrink"][-1]["chi2_per_nu"] < content["shrink"][0]["chi2_per_nu"]
    gap_picture(found, [the_bench.site], tmp_path / "gap.png")
    candidates_picture(found, tmp_path / "candidates.png")
    assert (tmp_path / "gap.png").stat().st_size > 5000
    assert (tmp_path / "candidates.png").stat().st_size > 5000


def test_depth_error_moves_all_channels_of_a_level_together(rng):
    site = bench(levels(rng)).site
    covariance = site.data.noise.covariance
    rows = {(row.channel, row.level): k for k, row in enumerate(site.rows)}
    force, speed = rows["force", 9], rows["swe", 9]
    assert covariance[force, speed] > 0
    assert covariance[force, rows["swe", 8]] == pytest.approx(0.0)
    assert np.all(np.linalg.eigvalsh(covariance) > 0)


def test_jacobian_is_that_of_the_prediction(rng):
    the_bench = bench(levels(rng))
    fitted = the_bench.fit((), {})
    x = np.log([fitted.values["c_kpa"] / 1e3, fitted.values["m"]])
    step = 1e-2
    for k in range(2):
        up, down = x.copy(), x.copy()
        up[k], down[k] = x[k] + step, x[k] - step
        slope = (the_bench.predict(up) - the_bench.predict(down)) / (2 * step)
        assert fitted.jacobian[:, k] == pytest.approx(slope, abs=2e-3 * np.abs(slope).max())


def of_the_block(measured) -> ModelError:
    """By how much the fitted block differs from the true one: an effect of 3 % in the force is no noise."""
    true, fitted = (
        simulations.curves(4.0)
        for simulations in (true_simulations(), reduced.ReducedBook(reduced.block_model(6, 5, 5)))
    )
    depth = np.maximum(measured.depth, 0.1)
    force = [np.log(np.interp(depth, each.depth, each.force)) for each in (true, fitted)]
    parts = [
        np.stack([np.interp(depth, each.depth, part) for part in each.log_speed.T], axis=1)
        for each in (true, fitted)
    ]
    return ModelError("model: block", force[0] - force[1], parts[0] - parts[1])


def test_how_far_maps_and_model_differ_is_found_from_the_data(rng):
    """An error of the speeds that the data do not have, told as that of maps, falls to the least share of it;
    one of its size in the data stays."""
    measured = levels(rng)
    n = len(measured.depth)
    parts = np.zeros(
        (n, 1 + reduced.ReducedBook(reduced.block_model(6, 5, 5), np.r_[0.0, 3.0]).windows.n_parts)
    )
    parts[:, 0] = 0.4
    error = ModelError(IN_MAPS, np.zeros(n), parts, correlation=0.0)
    rough = replace(
        measured,
        swe_mean_m_per_s=measured.swe_mean_m_per_s * np.exp(0.4 * np.where(np.arange(n) % 2, 1.0, -1.0)),
    )
    shares = []
    for data in (measured, rough):
        the_bench = bench(data, errors=[error])
        before = variance_in_maps(the_bench)
        the_bench.settle_noise()
        shares.append(np.sqrt(variance_in_maps(the_bench) / before))
        (in_maps,) = [each for each in the_bench.scalable if each.name == IN_MAPS]
        assert in_maps.least * shares[-1] == pytest.approx(LEAST_IN_MAPS)  # of the assumed size, as before
        assert in_maps.most * shares[-1] == pytest.approx(1.0)
    assert shares[0] == pytest.approx(LEAST_IN_MAPS, rel=0.05)
    assert shares[1] > 0.8


def test_the_error_of_all_strains_lies_along_the_fitted_model(rng):
    """Of its first size, in the direction in which a gain of depth changes what the fit predicts."""
    nothing = np.zeros(
        (14, 1 + reduced.ReducedBook(reduced.block_model(6, 5, 5), [0.0, 3.0]).windows.n_parts)
    )
    error = ModelError(STRAIN, np.zeros(14), nothing, strain=0.05)
    the_bench = bench(levels(rng), errors=[error])
    fitted = the_bench.fit((), {})
    curves, reading = the_bench.curves_of(fitted)
    before = strain_error(the_bench)
    the_bench.strain_along(fitted)
    after = strain_error(the_bench)
    more, less = (the_bench.site.predict(curves, replace(reading, depth_gain=g)) for g in (1.01, 0.99))
    changes = np.array([row.channel in ("force", "swe") for row in the_bench.site.rows])
    direction = np.where(changes, (more - less) / 0.02, 0.0)
    assert after == pytest.approx(0.05**2 * np.outer(direction, direction), rel=1e-6, abs=1e-9)
    the_bench.strain_along(fitted)
    assert strain_error(the_bench) == pytest.approx(after, rel=1e-9, abs=1e-12), "its size stays"
    assert np.trace(before) == pytest.approx(np.trace(after), rel=0.3)


def strain_error(the_bench: SiteForwardModel) -> np.ndarray:
    (part,) = [each for each in the_bench.data.noise.parts if each.name == STRAIN]
    return part.covariance


def variance_in_maps(the_bench: SiteForwardModel) -> float:
    (part,) = [each for each in the_bench.data.noise.parts if each.name == IN_MAPS]
    return float(np.trace(part.covariance))


@pytest.mark.slow
def test_a_size_that_the_data_do_not_tell_is_a_plausible_one(rng):
    """Fat goes into c and m, which least squares alone would follow to a bound: its prior keeps it inside."""
    the_bench = bench(levels(rng), names=("adipose-layer",))
    the_bench.fit((), {})
    fitted = the_bench.fit(("adipose-layer",), {"log_fat_softness": 2.9})
    softness = {each.name: each.prior for each in the_bench.sizes("adipose-layer")}["log_fat_softness"]
    assert not any("higher bound" in each for each in fitted.at_bound.values())
    assert abs(fitted.values["log_fat_softness"] - softness.mean) < softness.deviation


@pytest.mark.slow
def test_an_effect_that_changes_much_leaves_the_tissue_less_certain(rng):
    fibres = ((effect("anisotropy"), {"fibre_shear_per_c": 1.0, "fibre_tension_per_c": 0.5}),)
    the_bench = bench(levels(rng, fibres), names=("anisotropy", "force-zero"))
    base = the_bench.fit((), {})
    fitted, data = the_bench.fit(("anisotropy",), {}), the_bench.data
    form = form_error(data, fitted)
    alone, with_form = (
        posterior(fitted, data.y, data.noise, form=each).deviation[1] for each in (None, form)
    )
    assert with_form > 1.02 * alone
    assert form_error(data, base) is None


def test_curves_between_solved_exponents_are_those_of_a_simulation(rng):
    """m 2, 5 and 10 are solved; from 1 to 9 the rest follows."""
    the_bench = bench(levels(rng), names=("force-zero",))
    one = the_bench.sites[0]
    for m in (2.0, 5.0, 10.0):
        one.solve_nodes([m])
    for m in (1.0, 1.5, 3.0, 4.0, 7.0, 9.0):
        c = one.simulations.c
        true, between = one.simulations.curves(m), one.curves(c, m, AtPoints(), {})
        assert between.force[1:] == pytest.approx(true.force[1:], rel=5e-3)
        seen = np.isfinite(true.log_speed)
        assert between.log_speed[seen] == pytest.approx(true.log_speed[seen], abs=8e-3)


def test_a_fit_beyond_the_solved_exponents_has_one_of_its_own(rng):
    the_bench = bench(levels(rng, m=14.0), names=("force-zero",))
    fitted = the_bench.fit((), {})
    assert fitted.values["m"] == pytest.approx(14.0, rel=0.1)
    assert min(abs(np.log(node / fitted.values["m"])) for node in the_bench.sites[0].nodes) < 0.1


def test_an_effect_that_spreads_the_load_is_solved_once_at_its_start(rng, monkeypatch):
    """The kept deformation tells half of it here; the sensitivity is that of the simulation nevertheless."""
    whole = reduced.ReducedBook.shift
    monkeypatch.setattr(
        reduced.ReducedBook,
        "shift",
        lambda self, m, ingredients: tuple(0.5 * x for x in whole(self, m, ingredients)),
    )
    one, skin = bench(levels(rng), names=("skin-layer",)).sites[0], effect("skin-layer")
    one.solve_nodes([2.0])
    theta = {"log_skin_ratio": 1.5}
    true = logs(one.simulations.curves(2.0, ((skin, {**skin.grid[0], **theta}),))) - logs(
        one.simulations.curves(2.0)
    )
    found = one.changes.of(skin, skin.grid[0])(theta)
    assert np.abs(true[1:, 0]).max() > 0.05
    seen = np.isfinite(true[1:])
    assert found[1:][seen] == pytest.approx(true[1:][seen], abs=1e-9)


def test_what_an_effect_spreads_is_told_where_it_was_not_simulated(rng, monkeypatch):
    one, skin = bench(levels(rng), names=("skin-layer",)).sites[0], effect("skin-layer")
    one.solve_nodes([2.0])
    whole = one.simulations.curves

    def curves(m, ingredients=()):
        if ingredients:
            raise SolveError("it takes too long", where="here", fix="none")
        return whole(m)

    monkeypatch.setattr(one.simulations, "curves", curves)
    change = one.changes.of(skin, skin.grid[0])({"log_skin_ratio": 1.5})
    assert np.abs(change[1:, 0]).max() > 0.05  # of the kept deformation
    assert one.changes.not_simulated == {"skin-layer": "it takes too long"}


@pytest.mark.slow
def test_where_the_work_is_spent_a_fit_is_told_to_be_by_sensitivities_only(rng):
    measured = levels(rng, ((effect("contraction"), {"active_stress_per_c": 0.8}),))
    made = bench(measured, ("contraction", "force-zero"))
    made.fit((), {})
    fitted = made.fit(("contraction",), {})
    made.sites[0].simulations.spent = True
    assert made.verified(fitted) is None
    assert made.not_simulated == {("contraction",)}
    made.sites[0].simulations.spent = False
    assert made.verified(fitted) not in (None, fitted)
    without = made.fit(("force-zero",), {})
    assert made.verified(without) is without
    assert made.not_simulated == {("contraction",)}


class WithoutBone(reduced.ReducedBook):
    """The beam meets none."""

    def _raw(self, m, ingredients):
        return replace(super()._raw(m, ingredients), thickness=float("nan"))


def test_where_no_bone_is_under_the_probe_what_needs_one_is_not_evaluated():
    simulations = WithoutBone(reduced.block_model(6, 5, 5), np.linspace(0, 9, 6))
    site = site_data(
        "p1", SiteReadings(levels(np.random.default_rng(1)), reduced.NOISE, windows=simulations.windows)
    )
    names = ("force-zero", "swe-guided-wave")
    bench = SiteForwardModel([SiteCurves(site, simulations, {name: effect(name) for name in names})])
    found = diagnose(bench)
    assert found.verdict == "adequate"
    assert "bone" in found.not_evaluated["swe-guided-wave"]


def test_a_prediction_that_is_not_a_number_is_no_answer():
    skin_bone = np.r_[24.0, np.full(len(levels(np.random.default_rng(1)).depth) - 1, np.nan)]
    simulations = WithoutBone(reduced.block_model(6, 5, 5), np.linspace(0, 9, 6))
    data = replace(levels(np.random.default_rng(1)), skin_bone=skin_bone)
    site = site_data("p1", SiteReadings(data, reduced.NOISE, windows=simulations.windows))
    with pytest.raises(SolveError, match="not a number"):
        diagnose(SiteForwardModel([SiteCurves(site, simulations, {})]))


def test_curves_are_composed_once_for_every_c_and_every_reading(rng, monkeypatch):
    model = bench(levels(rng), names=("force-zero", "skin-layer"))
    (site,) = model.sites
    for m in (2.0, 5.0):
        site.solve_nodes([m])
    composed, of = [], site.changes.of
    monkeypatch.setattr(site.changes, "of", lambda *args: composed.append(args) or of(*args))
    pair = AtPoints(("skin-layer", "force-zero"), ({"skin_thickness_mm": 1.5}, {}))
    theta = {"log_skin_ratio": 3.0, "force_zero_n": 0.3}
    first = site.curves(0.006, 4.0, pair, theta)
    stiffer = site.curves(0.012, 4.0, pair, {**theta, "force_zero_n": -0.2})
    assert len(composed) == 1
    np.testing.assert_allclose(stiffer.force, 2.0 * first.force)
    shown = np.isfinite(first.log_speed)
    np.testing.assert_allclose((stiffer.log_speed - first.log_speed)[shown], 0.5 * np.log(2.0))
    softer = site.curves(0.006, 4.0, pair, {**theta, "log_skin_ratio": 1.0})
    assert len(composed) == 2
    assert softer.force[-1] < first.force[-1]
    site.repair(4.0, pair, theta)  # what a simulation corrects is not what was composed before
    repaired = site.curves(0.006, 4.0, pair, theta)
    assert abs(repaired.force[-1] / first.force[-1] - 1.0) > 1e-6
