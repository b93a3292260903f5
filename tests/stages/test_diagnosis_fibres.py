"""A diagnosis takes the fibres cell by cell, as a case's fibre map has them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from limbcli.diagnosis.curves.curve_plan import Solving
from limbcli.diagnosis.curves.site_simulations import SiteSimulations
from limbcli.diagnosis.data.windows import Windows
from limbcli.diagnosis.prepare import Preparation, WorkingMesh
from limbcli.effects import effect
from limbcli.effects.tissue import TISSUE
from limbcli.model import ElementMap
from limbcli.progress import SILENT
from tests.imaging.test_fibre_map import write as write_map
from tests.stages import block_case
from tests.stages.test_site_fibres import case_with, in_patient, made

pytestmark = pytest.mark.slow

__all__ = ["made"]  # a fixture

WINDOWS = Windows(-10.0, 10.0, 1.0, 10.0, across=2, down=1)
FIBRES = (
    ("anisotropy", {"fibre_shear_per_c": 1.0, "fibre_tension_per_c": 0.5}),
    ("contraction", {"active_stress_per_c": 0.5}),
)
ALONG_LATERAL, ACROSS = np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])


def turning_map(path: Path) -> None:
    """Along the limb at the patient's left (x > 0 in LPS), 45 deg to it on the right."""
    affine = np.diag([4.0, 4.0, 4.0, 1.0])
    affine[:3, 3] = np.array([-40.0, -40.0, -70.0])
    stored = np.zeros((20, 20, 35, 3))
    x_lps = -(affine[0, 3] + 4.0 * np.arange(20))
    stored[...] = np.where(x_lps[:, None, None, None] > 0, [0.0, 0.0, 1.0], [-1.0, 0.0, 1.0])  # RAS
    write_map(path, stored, affine=affine)


def test_the_working_model_has_the_direction_of_the_map_in_every_cell(made):
    folder, out = made
    turning_map(folder / "v1.nii.gz")
    (folder / "levels.csv").write_text(
        "force_n,depth_mm,swe_mean_m_per_s\n0,0,1.7\n1,1,1.8\n2,2,1.9\n3,3,2\n"
    )
    case = case_with(folder, imaging='fibres = "v1.nii.gz"\n')
    preparation = Preparation(case, case.sites[0], out, WorkingMesh(size=6.0), SILENT)
    simulations = preparation.simulated()
    simulations.close()
    model, block = simulations.model, simulations.model.mesh.block("tissue")
    middles = in_patient(model, model.mesh.points[block.cells].mean(axis=1))
    origin = np.array(model.info["patient_from_model"]).reshape(4, 4)[:3, 3]
    x = (middles + origin)[:, 0]
    for name, theta in FIBRES:
        applied = effect(name).apply(model, theta)
        axes = in_patient(model, applied.materials[TISSUE].parts[-1].parameters["fiber"].values)
        left, right = x > 6.0, x < -6.0
        assert left.sum() > 20
        assert right.sum() > 20
        np.testing.assert_allclose(np.abs(axes[left] @ [0.0, 0.0, 1.0]), 1.0, atol=1e-6)
        np.testing.assert_allclose(np.abs(axes[right] @ [1.0, 0.0, 1.0]) / np.sqrt(2), 1.0, atol=1e-6)
    assert preparation.notes.data["fibres"] == "diffusion MRI (v1.nii.gz)"


@pytest.fixture(scope="module")
def solved():
    """By name of effect and fibres: the curves of a block whose fibres lie as that says."""
    block = block_case.block_model("tet10", counts=(6, 2, 2))
    cells = block.mesh.block("tissue").cells
    left = block.mesh.points[cells].mean(axis=1)[:, 0] < 0
    axes = {
        "lateral": np.tile(ALONG_LATERAL, (len(cells), 1)),
        "across": np.tile(ACROSS, (len(cells), 1)),
        "both": np.where(left[:, None], ALONG_LATERAL, ACROSS),
    }
    found = {}
    for name, values in axes.items():
        model = replace(block, fibres=ElementMap("fibres", "tissue", values))
        simulations = SiteSimulations(
            model, (0.5, 1.0, 2.0), c=0.006, windows=WINDOWS, solving=Solving(tolerance=1e-5, threads=1)
        )
        for each, theta in FIBRES:
            found[each, name] = simulations.curves(4.0, ((effect(each), theta),))
        simulations.close()
    return found


@pytest.mark.parametrize("name", ["anisotropy", "contraction"])
def test_each_side_of_the_image_shows_the_fibres_that_it_has(solved, name):
    """Left half along the image, right half across it: each part of the map as with the whole so, at
    first touch (where parts do not feel each other by the load), and the force between the two."""
    lateral, across, both = (solved[name, way] for way in ("lateral", "across", "both"))
    one, other = lateral.log_speed[0, 1:], across.log_speed[0, 1:]
    assert one[0] - other[0] > 0.05  # waves run faster along fibres
    assert both.log_speed[0, 1] == pytest.approx(one[0], abs=0.3 * (one[0] - other[0]))
    assert both.log_speed[0, 2] == pytest.approx(other[1], abs=0.3 * (one[1] - other[1]))
    low, high = sorted([lateral.force[-1], across.force[-1]])
    assert low - 1e-6 <= both.force[-1] <= high + 1e-6
    assert high > 1.001 * low
