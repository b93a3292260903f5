"""The refinement study with a surrogate for the solver, and once with the solver itself."""

from __future__ import annotations

import csv

import numpy as np
import pytest

from limbcli.case import Case
from limbcli.fitting.numerical_error import studied_error
from limbcli.meshing.mending import mend
from limbcli.meshing.remesh import Sizes
from limbcli.meshing.site_model import MeshOptions
from limbcli.meshing.surfaces import Triangles
from limbcli.provenance.chain_inputs import CaseInputs
from limbcli.results import open_stage, read_result
from limbcli.site_model import mesh_study
from limbcli.site_model.mesh_study import (
    TissueLaw,
    full_depth,
    reference_force,
    studied_tissue,
    study_site,
)
from limbcli.site_model.segmented_limb import MeshInputs

CASE = """format = 1
[subject]
id = "S1"
limb = "left"
[imaging]
skin = "skin.stl"
bones = ["skin.stl"]
[probe]
name = "small"
length_mm = 24.0
width_mm = 12.0
edge_radius_mm = 2.0
[[site]]
name = "p1"
position_mm = [0.0, 29.5, 0.0]
long_axis = "transverse"
levels = "levels.csv"
"""
OPTIONS = MeshOptions(element="tet4", margin=16.0, sizes=Sizes(5.0, 12.0), spacing=2.0)


def limb():
    t = np.linspace(0, 2 * np.pi, 32, endpoint=False)
    parts = []
    for radius, low, high in ((30.0, -50, 50), (9.0, -60, 60)):
        z = np.linspace(low, high, 16)
        points = np.vstack([np.c_[radius * np.cos(t), radius * np.sin(t), np.full(32, h)] for h in z])
        k, i = np.divmod(np.arange(15 * 32), 32)
        a, b = k * 32 + i, k * 32 + (i + 1) % 32
        parts.append(Triangles(points, np.vstack([np.c_[a, b, b + 32], np.c_[a, b + 32, a + 32]])))
    return mend(parts[0], [parts[1]])


@pytest.fixture
def case(tmp_path):
    (tmp_path / "skin.stl").write_text("")
    (tmp_path / "levels.csv").write_text("force_n,depth_mm\n0.5,0\n2,2\n4,3\n")
    (tmp_path / "case.toml").write_text(CASE)
    return Case.open(tmp_path)


@pytest.mark.slow
def test_error_of_a_known_law_is_found(case, tmp_path, monkeypatch):
    """A force of 5 + 0.01 h^2 N that a cut 20 mm farther would lower by 2 %."""

    def force(model, depth, tissue):
        assert depth == 3.0
        near = 1.02 if model.info["margin_mm"] < 30 else 1.0
        return near * (5 + 0.01 * model.info["size_under_probe_mm"] ** 2)

    monkeypatch.setattr(mesh_study, "reference_force", force)
    monkeypatch.setattr(mesh_study, "SIZE_FACTORS", (1.0, 1.3, 0.8))
    monkeypatch.setattr(mesh_study, "MARGIN_FACTORS", (1.0, 2.0))
    with open_stage(tmp_path / "out", "segment", subject="S1") as writer:
        pass
    inputs = MeshInputs(CaseInputs(case), writer.result, {})
    made = study_site(inputs, case.sites[0], limb(), OPTIONS, out=tmp_path / "out")
    assert made.data["force_extrapolated_n"] == pytest.approx(1.02 * 5)
    assert made.data["order"] == pytest.approx(2.0)
    assert made.data["size_error_fraction"] == pytest.approx(1.25 * 0.01 * 25 / 5)
    assert made.data["crop_error_fraction"] == pytest.approx(0.02)
    assert made.data["numerical_error_fraction"] == pytest.approx(np.hypot(0.0625, 0.02))
    back = read_result(tmp_path / "out", "mesh-study", site="p1")
    with back.path("table").open() as stream:
        assert len(list(csv.DictReader(stream))) == 4
    assert back.path("picture").is_file()


def test_a_site_that_was_fitted_is_studied_with_its_own_tissue(case, tmp_path):
    out = tmp_path / "out"
    with open_stage(out, "mesh-study", subject="S1", site="p1") as writer:
        assert studied_tissue(case.sites[0], out, writer) == TissueLaw()
    with open_stage(out, "fit", subject="S1", site="p1") as fitted:
        fitted.data.update(c_kpa=5.0, f_kappa=1.3, m=4.0)
    with open_stage(out, "mesh-study", subject="S1", site="p1") as writer:
        assert studied_tissue(case.sites[0], out, writer) == TissueLaw(0.005, 1.3, 4.0, "fit")


def test_depth_is_that_of_the_deepest_level(case):
    assert full_depth(case.sites[0]) == 3.0
    case.sites[0].levels.write_text("nonsense\n")
    assert full_depth(case.sites[0]) == 8.0


@pytest.mark.slow
def test_reference_solver_gives_a_force_on_a_meshed_site(case):
    from limbcli.meshing.probe import ProbeShape
    from limbcli.meshing.site_model import site_model

    made = site_model(limb(), (0.0, 29.5, 0.0), "transverse", ProbeShape(24, 12, 2), OPTIONS)
    shallow, deep = reference_force(made.model, 1.0), reference_force(made.model, 2.0)
    assert 0 < 1.8 * shallow < deep


def test_a_study_of_another_mesh_is_not_used(case, tmp_path):
    site = case.sites[0]

    def leave(stage, **data):
        with open_stage(tmp_path, stage, subject="S1", site=site.name) as writer:
            writer.data.update(data)

    def error():
        with open_stage(tmp_path, "fit", subject="S1", site=site.name) as writer:
            return studied_error(case, site, tmp_path, writer), writer.warnings

    assert error() == (None, [])
    leave("mesh-study", numerical_error_fraction=0.07, element="tet4", size_under_probe_mm=2.5)
    leave("mesh", element="tet4", size_under_probe_mm=2.5)
    assert error() == (0.07, [])
    leave("mesh", element="tet4", size_under_probe_mm=4.0)
    found, warnings = error()
    assert found is None
    assert "size_under_probe_mm 2.5 instead of 4.0" in warnings[0]
