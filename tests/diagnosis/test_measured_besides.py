"""Numbers measured besides, and sites that share a place."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from limbcli.diagnosis.data.rows import ExtraMeasurement, SiteReadings
from limbcli.diagnosis.data.site_data import site_data
from limbcli.diagnosis.data.windows import Windows
from limbcli.diagnosis.forward_model.measurement_menu import items, known
from limbcli.effects.curves import Curves
from limbcli.effects.reading import Protocol, Reading
from limbcli.errors import CaseError
from tests.diagnosis import reduced
from tests.diagnosis.hidden_cases import COARSE, Case

DEPTH = np.linspace(0, 10, 11)
CURVES = Curves(DEPTH, 0.2 * DEPTH**1.5, np.zeros((11, 0)), np.zeros(0), 30.0)
PROTOCOL = Protocol(np.arange(5.0), np.linspace(0, 8, 5), np.full(5, 20.0))


def test_each_number_is_what_a_reading_says_of_it():
    found = {e.name: e for e in known({"tare_n": 0.4, "force_gain": 1.02, "first_depth_mm": 0.5})}
    assert set(found) == {"tare", "known weight", "lift-off"}
    reading = Reading(force_zero=0.4, force_gain=1.02, depth_zero=0.5)
    for each in found.values():
        assert each.see(CURVES, reading, PROTOCOL) == pytest.approx(each.y, abs=1e-9)
        assert each.see(CURVES, Reading(), PROTOCOL) != pytest.approx(each.y, abs=1e-3)


def test_rate_ratio_is_one_for_an_elastic_tissue_and_more_for_a_relaxing_one():
    (extra,) = known({"rate_ratio": 1.2})
    assert extra.see(CURVES, Reading(), PROTOCOL)[0] == pytest.approx(0.0)
    assert extra.see(CURVES, Reading(prony=((0.5, 3.0),)), PROTOCOL)[0] > 0.1
    assert extra.y[0] == pytest.approx(np.log(1.2))


@pytest.mark.parametrize("name", ["two rates", "hold"])
def test_the_deepest_level_is_meant_also_where_the_way_back_was_read(name):
    item = next(each for each in items() if each.name == name)
    way = np.r_[0:5, 3:-1:-1]
    there_and_back = Protocol(PROTOCOL.force[way], PROTOCOL.depth[way], np.full(9, 20.0))
    reading = Reading(prony=((0.5, 3.0),))
    alone = item.see(CURVES, reading, PROTOCOL)
    assert item.see(CURVES, reading, there_and_back) == pytest.approx(alone)
    assert np.abs(alone).max() > 0.1


def test_the_way_back_is_told_by_the_phase_of_levels_not_by_an_error_of_depth():
    """The last depth but one of a loading may read deeper than the last."""
    rng = np.random.default_rng(7)
    loaded = reduced.measured(rng)
    depth = loaded.depth.copy()
    depth[-2] = depth[-1] + 0.2
    for phase, back in (("load", False), ("unload", True)):
        levels = replace(loaded, depth=depth, phase=("load",) * 13 + (phase,))
        site = site_data("p1", SiteReadings(levels, reduced.NOISE, windows=Windows()))
        assert ("force, unloading" in site.data.groups) is back
        assert any(site.protocol.unloading) is back


def test_unloading_of_a_relaxing_tissue_lies_below_its_loading():
    unload = next(item for item in items() if item.name == "unload")
    back = unload.see(CURVES, Reading(prony=((0.5, 20.0),)), PROTOCOL)
    elastic = unload.see(CURVES, Reading(), PROTOCOL)
    assert len(back) == len(PROTOCOL) - 1
    assert elastic == pytest.approx(0.2 * PROTOCOL.depth[-2::-1] ** 1.5, abs=2e-3)
    assert np.all(back[:3] < elastic[:3])


@pytest.mark.parametrize(("key", "value"), [("tare", 0.4), ("rate_ratio", -1.0), ("tare_n", float("nan"))])
def test_what_cannot_be_is_refused_with_what_can(key, value):
    with pytest.raises(CaseError) as caught:
        known({key: value})
    assert caught.value.where == "--measured"
    assert caught.value.fix


def test_maps_that_are_proposed_are_known_no_better_than_a_model_shows_them():
    """The mean of a level is what they are contrasted with; their patterns have a model's error."""
    site = Case("nothing", {}, 7, COARSE).curves(reduced.measured(np.random.default_rng(7)))
    maps = next(item for item in items() if item.name == "speed maps")
    error = maps.model_error(site)
    n_parts = site.simulations.windows.n_parts
    of_level = np.sqrt(np.diag(error)).reshape(-1, n_parts)
    assert len(of_level) == len(site.site.protocol)
    assert of_level[0] == pytest.approx(0.001, rel=0.1)
    assert (
        np.corrcoef(of_level.mean(axis=1), site.site.protocol.depth)[0, 1] > 0.97
    )  # a part of it grows with its square
    assert 0.06 < of_level[-1].mean() < 0.25  # beside 0.035 of noise: as at the worst of sites
    over_level = np.kron(np.eye(len(of_level)), np.ones(n_parts))
    assert over_level @ error @ over_level.T == pytest.approx(0.0, abs=1e-12)


def test_a_further_measurement_brings_its_models_error_with_it():
    levels = reduced.measured(np.random.default_rng(7))
    error = np.array([[4e-4, 2e-4], [2e-4, 9e-4]])
    extra = ExtraMeasurement("two", lambda c, r, p: np.zeros(2), np.zeros(2), np.array([0.01, 0.02]), error)
    site = site_data("p1", SiteReadings(levels, reduced.NOISE, windows=Windows(), extras=[extra]))
    at = [k for k, row in enumerate(site.rows) if row.channel == "two"]
    found = site.data.noise.covariance[np.ix_(at, at)]
    assert found == pytest.approx(error + np.diag([1e-4, 4e-4]))
