"""Two measurements of one place, the second with the probe turned by 90 degrees."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from limbcli.diagnosis.data.noise_parts import GAIN_OF_SPEEDS
from limbcli.diagnosis.data.rows import SiteReadings
from limbcli.diagnosis.data.site_data import joined, site_data, slices
from limbcli.diagnosis.explanations.verdict import diagnose
from limbcli.diagnosis.forward_model.site_forward_model import SiteForwardModel
from limbcli.diagnosis.forward_model.surrogate import SiteCurves
from limbcli.diagnosis.written_result import reported_sizes, sizes_of
from limbcli.effects import effect
from limbcli.effects.reading import Reading
from tests.diagnosis import reduced

CANDIDATES = ("force-zero", "force-gain", "anisotropy", "swe-time-scale", "skin-layer")
# Patient from model: the limb's axis is the model's y, or (the probe along the limb) its x.
ACROSS = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
ALONG = np.array([[0.0, 1, 0, 0], [0, 0, 1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])


def simulations(axes: np.ndarray, cells=(6, 5, 5), n=6, deepest=9.0, **more):
    model = reduced.block_model(*cells)
    model = replace(model, info={**model.info, "patient_from_model": axes.ravel().tolist()})
    return reduced.ReducedBook(model, np.linspace(0, deepest, n), **more)


def measurement(rng, axes, ingredients=(), reading=None):
    truth = simulations(axes, (7, 6, 6), 8, 10.0, spread=1.03)
    return reduced.measured(rng, ingredients, reading, simulations=truth)


def curves(name, levels, axes):
    b = simulations(axes)
    site = site_data(name, SiteReadings(levels, reduced.NOISE, windows=b.windows))
    return SiteCurves(site, b, {each: effect(each) for each in CANDIDATES})


def test_one_site_is_as_it_was(rng):
    levels = measurement(rng, ACROSS)
    alone = curves("p1", levels, ACROSS)
    assert joined([alone.site]) is alone.site.data


def test_noise_is_each_sites_own_but_for_the_scanners_gain(rng):
    sites = [curves(name, measurement(rng, axes), axes).site for name, axes in (("a", ACROSS), ("b", ALONG))]
    data = joined(sites)
    first, second = slices(sites)
    across = data.noise.covariance[first, second]
    gain = next(p for p in sites[0].data.noise.parts if p.name == GAIN_OF_SPEEDS).covariance.max()
    speeds = np.array([row.channel == "swe" for row in sites[0].rows])
    assert across[np.ix_(speeds, speeds)] == pytest.approx(gain)
    assert across[np.ix_(~speeds, ~speeds)] == pytest.approx(0.0)
    assert set(data.blocks) >= {"site a", "site b"}
    assert "b: mean speed" in data.groups


@pytest.mark.parametrize("sources", [("repeats", "assumed"), ("assumed", "repeats")])
def test_noise_is_assumed_where_that_of_one_site_is(rng, sources):
    """Whichever stands first in the case."""
    levels, windows = measurement(rng, ACROSS), simulations(ACROSS).windows
    sites = [
        site_data(source, SiteReadings(levels, replace(reduced.NOISE, source=source), windows=windows))
        for source in sources
    ]
    assert joined(sites).noise.is_assumed
    assert not joined([sites[sources.index("repeats")]] * 2).noise.is_assumed


def test_what_changes_each_time_has_a_size_for_each_measurement(rng):
    both = SiteForwardModel(
        [curves("a", measurement(rng, ACROSS), ACROSS), curves("b", measurement(rng, ALONG), ALONG)]
    )
    assert [s.name for s in both.slots(("force-zero", "force-gain"))] == [
        "force_zero_n@a", "force_zero_n@b", "force_gain",
    ]  # fmt: skip
    found = {"force-zero": {"force_zero_n@a": (0.8, 1.2), "force_zero_n@b": (-0.2, 0.2)}}
    for each, ends in zip(both.sites, ((0.8, 1.2), (-0.2, 0.2)), strict=True):
        reported = reported_sizes(sizes_of(both, each.site), found, 6.0)
        assert reported["force-zero"] == {"f0_n": pytest.approx(ends)}
    values = {"force_zero_n@a": 1.0, "force_zero_n@b": 2.0}
    assert both.theta(values, ("force-zero",), 1) == {"force_zero_n": 2.0}


@pytest.mark.slow
def test_an_offset_in_one_measurement_is_found_there(rng):
    offset = measurement(rng, ALONG, reading=Reading(force_zero=1.2))
    both = SiteForwardModel([curves("a", measurement(rng, ACROSS), ACROSS), curves("b", offset, ALONG)])
    found = diagnose(both, propose=False)
    assert ("force-zero",) in found.confidence_set
    fitted = next(r.posterior.fitted for r in found.explanations if r.explanation == ("force-zero",))
    assert fitted.values["force_zero_n@b"] == pytest.approx(1.2, abs=0.3)
    assert abs(fitted.values["force_zero_n@a"]) < 0.3


@pytest.mark.slow
def test_turning_the_probe_tells_fibres_from_another_time_scale_of_the_waves(rng):
    """Across the fibres alone both make the force too high for the speeds; along them they part."""
    fibres = ((effect("anisotropy"), {"fibre_shear_per_c": 1.2, "fibre_tension_per_c": 0.4}),)
    first = measurement(rng, ACROSS, fibres)
    alone = diagnose(SiteForwardModel([curves("a", first, ACROSS)]), propose=False)
    both = SiteForwardModel([curves("a", first, ACROSS), curves("b", measurement(rng, ALONG, fibres), ALONG)])
    together = diagnose(both, propose=False)
    assert ("anisotropy",) in together.confidence_set
    assert ("swe-time-scale",) not in together.confidence_set
    assert len(together.confidence_set) <= max(len(alone.confidence_set), 1)
