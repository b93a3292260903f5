"""Skin and fat: where their thickness comes from, what they are made of, and that a fit sees them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from limbcli.case import Case
from limbcli.errors import CaseError
from limbcli.feb.read import read_feb
from limbcli.feb.settings import schedule
from limbcli.model import Block, Domain, LimbModel
from limbcli.model.npz_file import load_model, save_model
from limbcli.results import StageResult, open_stage
from limbcli.site_model.indentation_model import indentation_model, window_cells
from limbcli.site_model.site_layers import (
    Layering,
    LayerLaw,
    ThicknessSource,
    layer_laws,
    parse_law,
    thickness_of,
    with_layer_laws,
)
from limbcli.solvers.session import ReferenceSession
from limbcli.stages.build_feb import TissueOptions, build_feb
from limbcli.stages.fit import FitOptions, fit
from limbcli.stages.limb import limb_layers
from tests.stages.block_case import block_model, make_case

DEPTHS = np.array([0.8, 1.6, 2.4, 3.2])
TRUTH = {"c": 0.008, "f_kappa": 40.0, "m": 3.0}
FAT = {"c_kpa": 2.0, "f_kappa": 20.0, "m": 2.0}
SEEN = {"p1": {"skin_mm": 1.2, "fat_mm": 6.3}}


def layered_block() -> LimbModel:
    """The block with its upper third as fat."""
    model = block_model("tet4")
    tissue, *probe = model.mesh.blocks
    top = model.mesh.points[tissue.cells][:, :, 2].mean(axis=1) > -16 / 3
    blocks = (Block("tissue", "tet4", tissue.cells[~top]), Block("fat", "tet4", tissue.cells[top]), *probe)
    domains = (Domain("tissue", "tissue"), Domain("fat", "tissue"))
    return replace(model, mesh=replace(model.mesh, blocks=blocks), domains=domains)


@pytest.fixture(scope="module")
def forces() -> np.ndarray:
    layered = with_layer_laws(layered_block(), {"fat": LayerLaw(c=0.002, f_kappa=20.0, m=2.0)})
    session = ReferenceSession(indentation_model(layered, schedule(list(DEPTHS)), **TRUTH))
    try:
        return session.solve().must_points.forces
    finally:
        session.close()


@pytest.fixture
def case(tmp_path: Path, forces: np.ndarray) -> Case:
    case = make_case(tmp_path / "case", tmp_path / "out", DEPTHS, forces, c=TRUTH["c"], build=False)
    with open_stage(tmp_path / "out", "mesh", subject=case.subject, site="p1") as writer:
        save_model(layered_block(), writer.file("model", "model.npz"))
    return case


def segmented(**layers: dict[str, float]) -> StageResult:
    return StageResult("segment", "B1", Path(), data={"layers": layers})


def test_thickness_comes_from_the_option_then_the_case_then_not_at_all(case: Case) -> None:
    site = case.sites[0]
    in_case = replace(site, layers={"fat": {"thickness_mm": 5.0}, "skin": {"thickness_mm": 1.5}})
    assert Layering(None, None).of(site, segmented(), size=2.5)[0] == ()
    layers, sources = Layering(None, None).of(in_case, segmented(), size=2.5)
    assert [(each.name, each.thickness) for each in layers] == [("skin", 1.5), ("fat", 5.0)]
    assert sources == {"skin": ThicknessSource("given"), "fat": ThicknessSource("given")}
    layers, _ = Layering(0.0, 7.0).of(in_case, segmented(), size=2.5)
    assert [(each.name, each.thickness) for each in layers] == [("fat", 7.0)]


def test_fat_from_the_images_ends_where_the_muscle_was_seen(case: Case) -> None:
    """Without a skin of its own the fat begins at the surface; the border stays 7.5 mm deep."""
    site = case.sites[0]
    both, sources = Layering("mri", "mri").of(site, segmented(**SEEN), size=2.5)
    assert [(each.name, each.thickness) for each in both] == [("skin", 1.2), ("fat", 6.3)]
    assert sources == {"skin": ThicknessSource("MRI"), "fat": ThicknessSource("MRI")}
    (fat,), sources = Layering(None, "mri").of(site, segmented(**SEEN), size=2.5)
    assert fat.thickness == pytest.approx(7.5)
    assert str(sources["fat"]) == "MRI: 6.3 mm of fat under 1.2 mm of skin"
    case = SimpleNamespace(sites=[site])
    _, words = limb_layers(case, Layering(None, "mri"), segmented(**SEEN), SimpleNamespace(warnings=[]))
    assert words == {"fat": "mean of 1 (MRI)"}


def test_images_that_tell_no_thickness_are_no_guess(case: Case) -> None:
    site = case.sites[0]
    with pytest.raises(CaseError, match="give no thickness of the fat") as caught:
        Layering(None, "mri").of(site, segmented(), size=2.5)
    assert "--fat-mm" in caught.value.fix
    with pytest.raises(CaseError, match="at the case's sites only"):
        Layering(None, "mri", seen=False).of(site, segmented(**SEEN), size=2.5)
    with pytest.raises(CaseError, match="--skin-mm is 'thin'"):
        thickness_of("thin", "--skin-mm")


def test_case_file_holds_layers(case: Case) -> None:
    text = case.file.read_text()
    table = '[site.layers.fat]\nthickness_mm = "mri"\nlaw = "neo_hooke"\nc_kpa = 1.2\n'
    case.file.write_text(text + table)
    site = Case.open(case.folder).sites[0]
    law = layer_laws(site, ["fat"])["fat"]
    assert (law.law, law.c, law.assumed) == ("neo_hooke", pytest.approx(0.0012), ("f_kappa",))
    for wrong, message in (
        ('[site.layers.fat]\nthickness_mm = "thick"\n', "not a number"),
        ("[site.layers.fat]\nc_kpa = 1.0\n", "is missing 'thickness_mm'"),
        ("[site.layers.tendon]\nthickness_mm = 1.0\n", "unknown layer 'tendon'"),
    ):
        case.file.write_text(text + wrong)
        with pytest.raises(CaseError, match=message):
            Case.open(case.folder)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("bone:c_kpa=2", "not valid"),
        ("fat", "not valid"),
        ("fat:c_kpa=soft", "not a number"),
        ("fat:stiffness=2", "unknown key 'stiffness'"),
        ("fat:f_kappa=1e9", "plausible"),
        ("fat:law=rubber", "one of"),
    ],
)
def test_a_law_that_cannot_be_read_is_refused(text: str, message: str) -> None:
    with pytest.raises(CaseError, match=message):
        parse_law(text)


def test_build_feb_gives_the_layer_its_own_material(case: Case, tmp_path: Path) -> None:
    out = tmp_path / "out"
    result = build_feb(case, out=out, options=TissueOptions(layers={"fat": FAT}))[0]
    model = read_feb(result.path("feb"))
    assert {each.block: each.material for each in model.domains} == {"tissue": "tissue", "fat": "fat"}
    assert model.materials["fat"].parameters["c1"] == pytest.approx(0.001)
    assert model.materials["fat"].parameters["kappa"] == pytest.approx(0.040)
    assert model.materials["tissue"].parameters["c1"] == pytest.approx(TRUTH["c"] / 2)
    assert result.data["layers"]["fat"] == {"law": "ogden", **FAT, "assumed": []}
    assert not any("assumed" in each for each in result.warnings)
    assert any("stiffer than its law" in each for each in result.warnings)
    with pytest.raises(CaseError, match="no layer 'skin'"):
        build_feb(case, out=out, options=TissueOptions(layers={"skin": {"c_kpa": 40.0}}))


def test_values_nobody_gave_are_said_to_be_assumed(case: Case, tmp_path: Path) -> None:
    result = build_feb(case, out=tmp_path / "out")[0]
    assert result.data["layers"]["fat"]["assumed"] == ["c_kpa", "f_kappa", "m"]
    assert any("the stiffness of the fat is assumed" in each for each in result.warnings)


def test_speeds_are_predicted_in_the_tissue_only(case: Case, tmp_path: Path) -> None:
    model = load_model(tmp_path / "out" / "mesh" / "p1" / "model.npz")
    layered = with_layer_laws(model, layer_laws(case.sites[0], ["fat"]))
    cells = window_cells(layered, 3.2)
    assert cells.max() < len(layered.mesh.block("tissue").cells)


@pytest.mark.slow
def test_the_tissue_below_known_fat_is_recovered(case: Case, tmp_path: Path) -> None:
    """With the fat's own law the truth comes back; with fat as stiff as tissue it cannot."""
    out = tmp_path / "out"
    found = {}
    for name, law in (("right", FAT), ("wrong", {**FAT, "c_kpa": 8.0})):
        build_feb(case, out=out, options=TissueOptions(layers={"fat": law}))
        result = fit(case, out=out, solver="reference", options=FitOptions(intervals=False))[0]
        found[name] = result.data
    assert found["right"]["f_kappa"] == pytest.approx(TRUTH["f_kappa"], rel=0.02)
    assert found["right"]["m"] == pytest.approx(TRUTH["m"], rel=0.05)
    assert found["right"]["rmse_n"] < 0.002
    assert abs(found["wrong"]["f_kappa"] / TRUTH["f_kappa"] - 1) > 0.3
