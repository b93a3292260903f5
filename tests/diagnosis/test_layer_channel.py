"""The layer channel: what it adds to the data, and that fat is seen by it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from limbcli.case import StatedNoise
from limbcli.diagnosis.curves.curve_plan import Solving
from limbcli.diagnosis.curves.site_simulations import SiteSimulations
from limbcli.diagnosis.data.rows import SiteReadings
from limbcli.diagnosis.data.site_data import site_data
from limbcli.diagnosis.explanations.verdict import diagnose
from limbcli.diagnosis.forward_model.changes import line_shift
from limbcli.diagnosis.forward_model.site_forward_model import SiteForwardModel
from limbcli.diagnosis.forward_model.surrogate import SiteCurves
from limbcli.diagnosis.written_result import diagnosis_json, gap_picture
from limbcli.effects import effect
from limbcli.effects.curves import Curves, continued
from limbcli.effects.reading import Protocol, read
from limbcli.effects.stiffness_places import Places
from limbcli.measurement.indentation import Levels
from limbcli.site_model.layer_readings import LayerReadings
from tests.diagnosis import reduced
from tests.stages import block_case

pytestmark = pytest.mark.slow

ALONE = Solving(threads=1)
REST = np.array([1.5, 8.0])
NOISE = replace(reduced.NOISE, layer=0.1)
CANDIDATES = ("force-zero", "depth-zero", "adipose-layer", "thickness", "skin-layer", "swe-guided-wave")


@dataclass
class SpringBook(reduced.ReducedBook):
    """The reduced model with borders: the column below the probe as springs in series, its own stiffness
    from place to place; `taper`: how much less it is squeezed at the bone than at the skin."""

    taper: float = 0.25

    def _raw(self, m, ingredients):
        curves = super()._raw(m, ingredients)
        height = float(-self.model.mesh.points[:, 2].min())
        z = (np.arange(400) + 0.5) / 400 * height
        places = Places(np.column_stack([np.zeros((400, 2)), -z]), self.model)
        compliance = 1.0 + self.taper * (0.5 - z / height)
        for each, theta in ingredients:
            if each.stiffness is not None:
                compliance = compliance / each.stiffness(places, theta)
        share = np.interp(REST, z, np.cumsum(compliance) / compliance.sum())
        below = np.maximum(REST - np.outer(self.depth, share), 0.05)
        return replace(curves, log_line=np.log(below))


def measured(rng, ingredients=()):
    """Levels and their layers: a finer block, another spread, another taper, noise."""
    simulations = SpringBook(reduced.block_model(7, 6, 6), np.linspace(0, 10, 8), spread=1.03, taper=0.35)
    levels = reduced.measured(rng, ingredients, simulations=simulations, noise=NOISE)
    curves, reading, protocol = reduced.truth(ingredients, simulations=simulations)
    thickness = read(curves, protocol, reading).layers
    return levels, LayerReadings(
        ("skin", "fat"), thickness + NOISE.layer * rng.standard_normal(thickness.shape), NOISE.layer, False
    )


def bench(levels, layers, names=CANDIDATES) -> SiteForwardModel:
    simulations = SpringBook(reduced.block_model(6, 5, 5), np.linspace(0, 9, 6))
    site = site_data("p1", SiteReadings(levels, NOISE, windows=simulations.windows, layers=layers))
    return SiteForwardModel([SiteCurves(site, simulations, {name: effect(name) for name in names})])


def test_layers_stand_in_the_data_with_their_noise(rng):
    levels, layers = measured(rng)
    with_layers = bench(levels, layers).site
    without = bench(levels, None).site
    mine = np.array([row.channel == "layer" for row in with_layers.rows])
    assert mine.sum() == 2 * (len(levels) - 1)
    assert len(with_layers.rows) == len(without.rows) + mine.sum()
    assert "layer" in with_layers.channels
    assert "layer" in without.missing
    covariance = with_layers.data.noise.covariance
    np.testing.assert_allclose(covariance[np.ix_(~mine, ~mine)], without.data.noise.covariance)
    fat = mine & np.array([row.part == 1 for row in with_layers.rows])
    common = covariance[np.ix_(fat, fat)]
    assert np.all(np.linalg.eigvalsh(common) > 0.5 * NOISE.layer**2)
    assert common[0, -1] > 0.5 * NOISE.layer**2  # the reading at first touch is in all of them
    assert np.all(with_layers.slope[fat] < 0)
    assert "layers" in with_layers.data.groups


def test_an_error_of_depth_moves_the_layers_as_the_noise_has_it(rng):
    levels, layers = measured(rng)
    the_bench = bench(levels, layers)
    the_bench.sites[0].solve_nodes((4.0, 8.0))
    x = np.log([0.0065, 4.0])
    fat = np.array([row.channel == "layer" and row.part == 1 for row in the_bench.site.rows])
    exact = the_bench.predict(x)[fat]
    expected = np.array([row.level for row, is_fat in zip(the_bench.site.rows, fat, strict=True) if is_fat])
    thinning = 6.5 - exact
    assert np.all(np.diff(thinning) > -0.1)
    slope = -the_bench.site.slope[fat]
    np.testing.assert_allclose(slope.mean(), thinning[-1] / levels.depth[expected[-1]], rtol=0.2)


def test_a_homogeneous_tissue_is_adequate_with_layers_too(rng):
    found = diagnose(bench(*measured(rng)))
    assert found.verdict == "adequate"
    assert found.base.values["c_kpa"] == pytest.approx(6.5, rel=0.1)


@pytest.mark.slow
def test_soft_fat_is_named_by_its_layers(rng, tmp_path):
    fat = ((effect("adipose-layer"), {"fat_thickness_mm": 8.0, "log_fat_softness": 0.9}),)
    levels, layers = measured(rng, fat)
    the_bench = bench(levels, layers)
    found = diagnose(the_bench)
    assert found.effects["adipose-layer"] > 0.9
    assert ("adipose-layer",) in found.confidence_set
    fitted = next(r.posterior.fitted for r in found.explanations if r.explanation == ("adipose-layer",))
    assert fitted.values["log_fat_softness"] == pytest.approx(0.9, abs=0.4)
    gap_picture(found, [the_bench.site], tmp_path / "gap.png")
    assert diagnosis_json(found, the_bench.site, the_bench)["channels"].count("layer") == 1


def test_without_layers_the_same_fat_is_not_seen(rng):
    """It is the layers that tell: force and mean speeds are bent to fit by another c and m."""
    fat = ((effect("adipose-layer"), {"fat_thickness_mm": 8.0, "log_fat_softness": 0.9}),)
    levels, layers = measured(rng, fat)
    p = {}
    for name, seen in (("with", layers), ("without", None)):
        the_bench = bench(levels, seen, names=("adipose-layer", "force-zero"))
        base = the_bench.fit((), {})
        fitted = the_bench.fit(("adipose-layer",), {})
        left = [the_bench.whiten(the_bench.data.y - each.prediction) for each in (base, fitted)]
        p[name] = float(left[0] @ left[0] - left[1] @ left[1])
    assert p["with"] > p["without"] + 9.0


def test_the_stand_in_of_the_lines_is_near_a_simulation(layered_block):
    """Springs in series against the solver: fat of a third of the stiffness."""
    layers = LayerReadings(("skin", "fat"), np.array([[1.0, 5.0]]), 0.1, False)
    fat = ((effect("adipose-layer"), {"fat_thickness_mm": 6.0, "log_fat_softness": 1.1}),)
    simulations = SiteSimulations(layered_block, [1.0, 2.0], c=0.006, solving=ALONE, layers=layers)
    plain, soft = simulations.curves(3.0), simulations.curves(3.0, fat)
    simulations.close()
    moved = line_shift(simulations.model, plain, fat)
    assert np.all(moved[0] == 0.0)
    # A small face spreads its load: springs in series make too much of it (1.6 times here).
    ratio = moved[1:, 1] / (soft.log_line - plain.log_line)[1:, 1]
    assert np.all((ratio > 0.5) & (ratio < 2.0))
    assert not line_shift(simulations.model, plain, ((effect("force-zero"), {"force_zero_n": 1.0}),)).any()


@pytest.mark.slow
def test_fat_in_a_finer_mesh_is_recovered_by_its_layers(layered_block, rng):
    """Truth by the solver on another mesh, noise on force, depth and layers; no wave speeds at all."""
    layers = LayerReadings(("skin", "fat"), np.array([[1.0, 5.0]]), 0.05, False)
    fat = ((effect("adipose-layer"), {"fat_thickness_mm": 6.0, "log_fat_softness": 1.1}),)
    depths = [0.5, 1.0, 2.0, 3.2]
    fine = SiteSimulations(skinned((6, 4, 6)), depths, c=0.0065, solving=ALONE, layers=layers)
    truth = fine.curves(4.0, fat)
    fine.close()
    n, nan = 7, np.full(7, np.nan)
    protocol = Protocol(np.zeros(n), np.linspace(0.0, 3.0, n), np.zeros(n))
    so, noise = read(truth, protocol), StatedNoise(0.02, 0.03, layer=0.05, source="repeats")
    off = [sd * np.r_[0.0, rng.standard_normal(n - 1)] for sd in (noise.force, noise.depth)]
    levels = Levels(
        force=so.force + off[0],
        depth=protocol.depth + off[1],
        swe_mean_m_per_s=nan,
        swe_sd_m_per_s=nan,
        swe_pixels=nan,
        phase=("load",) * n,
        hold=nan,
        probe_travel=nan,
        skin_bone=nan,
        path=Path("x"),
    )
    seen = replace(layers, thickness=so.layers + noise.layer * rng.standard_normal((n, 2)))
    simulations = SiteSimulations(layered_block, depths, c=0.006, solving=ALONE, layers=seen)
    site = site_data("p1", SiteReadings(levels, noise, windows=simulations.windows, layers=seen))
    the_bench = SiteForwardModel([SiteCurves(site, simulations, {"adipose-layer": effect("adipose-layer")})])
    base = the_bench.fit((), {})
    found = the_bench.verified(the_bench.fit(("adipose-layer",), {}))
    model, true = the_bench.model_of(found), {"log_fat_softness": 1.1, "fat_thickness_mm": 6.0}
    ended = the_bench.off(the_bench.x_of(found), model)
    the_bench.sites[0].repair(4.0, model, true)
    x = np.array(
        [
            *np.log([0.0065, 4.0]),
            *(true[slot.name] for slot in the_bench.slots(found.explanation)),
        ]
    )
    at_truth = the_bench.off(x, model)
    simulations.close()
    assert ended @ ended < at_truth @ at_truth
    left = [the_bench.whiten(the_bench.data.y - each.prediction) for each in (base, found)]
    assert left[0] @ left[0] > left[1] @ left[1] + 15.0
    assert left[1] @ left[1] < 2.0 * len(levels.force) * 3
    # c is free and no wave speed tells it: with 5 % of mesh error the standard error is 0.86.
    assert found.values["log_fat_softness"] == pytest.approx(1.1, abs=1.5 * 0.86)
    assert found.values["fat_thickness_mm"] == pytest.approx(6.0, abs=0.7)


def test_curves_carry_lines_beyond_their_end():
    depth = np.linspace(0.0, 4.0, 5)
    below = np.outer(1.0 - depth / 20, [1.5, 8.0])
    curves = Curves(depth, depth**1.3, np.zeros((5, 1)), np.zeros(1), 20.0, np.log(below))
    alone = continued(curves, [5.0])
    beside = continued(curves, [5.0], like=continued(curves, [6.0]))
    for each in (alone, beside):
        assert each.log_line.shape == (6, 2)
        np.testing.assert_allclose(np.exp(each.log_line[-1]), [1.5 * 0.75, 8.0 * 0.75], rtol=0.01)
    protocol = Protocol(np.zeros(2), np.array([0.0, 2.0]), np.zeros(2))
    np.testing.assert_allclose(read(curves, protocol).layers, [[1.5, 6.5], [1.35, 5.85]], atol=1e-3)


@pytest.fixture(scope="module")
def layered_block():
    return skinned((4, 2, 4))


def skinned(counts):
    """The block with its skin known by that name."""
    model = block_case.block_model(counts=counts)
    surfaces = {**model.mesh.surfaces, "skin": model.mesh.surfaces["contact"]}
    return replace(model, mesh=replace(model.mesh, surfaces=surfaces))


def test_simulated_curves_follow_the_borders_and_keeps_them(layered_block, tmp_path):
    layers = LayerReadings(("skin", "fat"), np.array([[1.0, 5.0]]), 0.1, False)
    fat = ((effect("adipose-layer"), {"fat_thickness_mm": 6.0, "log_fat_softness": 1.5}),)
    all_simulations = [
        SiteSimulations(
            layered_block,
            [1.0, 2.0],
            c=0.006,
            solving=ALONE,
            keep=tmp_path,
            layers=layers,
        )
        for _ in range(2)
    ]
    plain, soft = all_simulations[0].curves(3.0), all_simulations[0].curves(3.0, fat)
    all_simulations[0].close()
    np.testing.assert_allclose(np.exp(plain.log_line[0]), [1.0, 6.0])
    thinned = 6.0 - np.exp(plain.log_line[:, 1])
    assert np.all(np.diff(thinned) > 0.1)
    assert thinned[-1] < 2.0
    assert np.all(np.exp(soft.log_line[1:, 1]) < np.exp(plain.log_line[1:, 1]) - 0.02)
    np.testing.assert_array_equal(all_simulations[1].curves(3.0, fat).log_line, soft.log_line)
    assert all_simulations[1].n_solves == 0
    without = SiteSimulations(layered_block, [1.0, 2.0], c=0.006, solving=ALONE, keep=tmp_path)
    assert without.curves(3.0).log_line is None
    assert without.n_solves == 1
    without.close()


def test_noise_of_a_case_states_that_of_layers():
    assert StatedNoise().layer == 0.2
