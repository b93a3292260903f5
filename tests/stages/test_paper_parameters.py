"""The published parameter sets as a case: what stands in it, and what of its forces is the mesh."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest

from limbcli.case import Case
from limbcli.measurement.indentation import read_levels
from limbcli.measurement.shear_modulus import shear_modulus_from_wave_speed
from limbcli.meshing.elements import with_element
from limbcli.model.npz_file import load_model
from limbcli.stages.mesh import mesh
from limbcli.stages.segment import segment
from tests.benchmarks.paper_parameters import CASE, FORCES, PUBLISHED, forces_at


def test_speeds_expectations_and_parameters_agree():
    case = Case.open(CASE)
    expected = tomllib.loads((CASE / "expected.toml").read_text())["site"]
    assert [site.name for site in case.sites] == list(PUBLISHED) == list(expected)
    for site in case.sites:
        levels, rules = read_levels(site.levels), expected[site.name]
        c_kpa = 2e3 * shear_modulus_from_wave_speed(levels.swe_mean_m_per_s[:1])[0]
        assert c_kpa == pytest.approx(1e3 * PUBLISHED[site.name].c)
        assert c_kpa == pytest.approx(rules["c_kpa"]["value"], abs=1e-3)
        assert rules["f_kappa"]["value"] == PUBLISHED[site.name].f_kappa
        np.testing.assert_allclose(levels.force[1:], FORCES, rtol=0.02)


@pytest.mark.slow
def test_more_than_half_of_the_force_is_the_locking_of_the_mesh(tmp_path: Path):
    case, tissue = Case.open(CASE), PUBLISHED["S1"]
    segment(case, out=tmp_path)
    model = load_model(mesh(case, out=tmp_path, sites=["S1"])[0].path("model"))
    levels = read_levels(case.site("S1").levels)
    depth = levels.depth[1:2]
    linear = forces_at(model, depth, tissue, tolerance=1e-4)[0]
    assert linear == pytest.approx(levels.force[1], rel=0.01), "the mesher changed: write the case anew"
    quadratic = forces_at(with_element(model, "tet10"), depth, tissue, tolerance=1e-4)[0]
    assert 2.0 < linear / quadratic < 6.0
