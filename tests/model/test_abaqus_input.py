"""Abaqus input files: read again by meshio, the laws' energies, faces and groups."""

from __future__ import annotations

import itertools
import re
from dataclasses import replace
from pathlib import Path

import meshio
import numpy as np
import pytest

from limbcli.errors import CaseError
from limbcli.feb.read import read_feb
from limbcli.materials.energy import program_energy
from limbcli.materials.program import compile_material
from limbcli.model import Block, Domain, ElementMap, LimbModel, Material, Mesh, Surface
from limbcli.model.abaqus_input import AbaqusOgden, _groups, abaqus_ogden, write_abaqus

PUNCH = Path(__file__).parents[1] / "data" / "feb" / "punch.feb"
OGDEN = Material("ogden", {"c1": 0.004, "m1": 3.0, "c2": 0.006, "m2": -5.0, "kappa": 0.4})
LAWS = [
    OGDEN,
    Material("ogden_uncoupled", {"c1": 0.004, "m1": 3.0, "c2": 0.006, "m2": -5.0, "kappa": 0.4}),
    Material("mooney_rivlin", {"c1": 0.002, "c2": 0.001, "kappa": 0.4}),
    Material("neo_hooke", {"mu": 0.005, "lambda": 0.2}),
]
UNIT = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
EDGES = [(0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3)]  # of nodes 5 to 10 of C3D10 (Abaqus Elements Guide)


def abaqus_energy(law: AbaqusOgden, F: np.ndarray) -> float:
    J = np.linalg.det(F)
    stretches = np.linalg.svd(F, compute_uv=False) * J ** (-1 / 3)
    terms = [2 * m / a**2 * ((stretches**a).sum() - 3) for m, a in zip(law.mu, law.alpha, strict=True)]
    return float(sum(terms) + (J - 1) ** 2 / law.d1)


def our_energy(material: Material, F: np.ndarray) -> float:
    program = compile_material(material, "tissue").program(1, lambda _name: 1.0)
    return float(program_energy(program.ops, program.par, F[None, None])[0, 0])


@pytest.mark.parametrize("material", LAWS, ids=lambda each: each.law)
def test_energies_are_equal_without_change_of_volume_and_for_small_strains(material: Material):
    law = abaqus_ogden(material.law, material.parameters)  # type: ignore[arg-type]
    rng = np.random.default_rng(7)
    for _ in range(5):
        F = np.eye(3) + 0.4 * rng.standard_normal((3, 3))
        F *= np.sign(np.linalg.det(F)) * abs(np.linalg.det(F)) ** (-1 / 3)
        assert abaqus_energy(law, F) == pytest.approx(our_energy(material, F), rel=1e-9)
        small = np.eye(3) + 1e-4 * rng.standard_normal((3, 3))  # equal up to the third order in the strain
        assert abaqus_energy(law, small) == pytest.approx(our_energy(material, small), rel=5e-3)


def one_tetrahedron() -> LimbModel:
    points = np.concatenate([UNIT, [(UNIT[a] + UNIT[b]) / 2 for a, b in EDGES]])
    facets = {"tri6": np.array([[0, 2, 1, 6, 5, 4]]), "tri3": np.array([[0, 1, 3], [1, 2, 3], [0, 3, 2]])}
    mesh = Mesh(points, (Block("tissue", "tet10", np.arange(10)[None]),), {"fixed": np.array([0, 1, 2])},
                {"skin": Surface("skin", facets)})  # fmt: skip
    return LimbModel(mesh, {"tissue": OGDEN}, (Domain("tissue", "tissue"),))


def test_nodes_of_c3d10_are_in_abaqus_order_and_meshio_reads_the_file(tmp_path):
    write_abaqus(one_tetrahedron(), tmp_path / "a.inp")
    back = meshio.read(tmp_path / "a.inp")
    (block,) = back.cells
    assert block.type == "tetra10"
    corners = back.points[block.data[0]]
    for middle, (a, b) in zip(corners[4:], EDGES, strict=True):
        np.testing.assert_allclose(middle, (corners[a] + corners[b]) / 2)
    assert np.linalg.det(corners[1:4] - corners[0]) > 0
    assert back.point_sets["FIXED"].tolist() == [0, 1, 2]


def test_facets_become_faces_of_their_elements(tmp_path):
    write_abaqus(one_tetrahedron(), tmp_path / "a.inp")
    text = (tmp_path / "a.inp").read_text()
    lines = re.search(r"NAME=SURF_SKIN\n((?:\d+, S\d\n)+)", text)[1].split("\n")  # type: ignore[index]
    assert sorted(lines)[1:] == ["1, S1", "1, S2", "1, S3", "1, S4"]
    assert "*HYPERELASTIC, OGDEN, N=2\n0.002, 3, 0.003, -5, 4.95867769, 0\n" in text


def test_a_site_s_model_is_read_again_by_meshio(tmp_path):
    """A block under a rigid probe: contact, motion, and all its sets."""
    model = read_feb(PUNCH)
    write_abaqus(model, tmp_path / "a.inp")
    text = (tmp_path / "a.inp").read_text()
    linear = tmp_path / "b.inp"
    linear.write_text(text.replace("C3D4H", "C3D4"))  # meshio 5.3.5 has no cells for C3D4H
    back = meshio.read(linear)
    solids = [each for each in back.cells if each.type == "tetra"]
    assert sum(len(each.data) for each in solids) == sum(len(each.cells) for each in model.mesh.solid_blocks)
    np.testing.assert_allclose(back.points[:-1], model.mesh.points, atol=1e-7)  # the last: of the probe
    for keyword in (
        "*CONTACT PAIR",
        "*RIGID BODY, REF NODE=",
        "*AMPLITUDE",
        "*STATIC",
        "*END STEP",
        "** hard contact",
    ):
        assert keyword in text
    blocks = re.findall(r"^\*ELEMENT, .*\n((?:[\d, ]+\n)+)", text, re.MULTILINE)
    labels = [int(line.split(",")[0]) for each in blocks for line in each.splitlines()]
    assert len(labels) == len(set(labels))


def test_cells_of_unlike_stiffness_become_groups(tmp_path):
    model = one_tetrahedron()
    n = 300
    block = Block("tissue", "tet10", np.tile(np.arange(10), (n, 1)))
    values = np.linspace(0.001, 0.01, n)
    material = OGDEN.with_parameters(c1=ElementMap("c1", "tissue", values))
    model = replace(model, mesh=replace(model.mesh, blocks=(block,)), materials={"tissue": material})
    write_abaqus(model, tmp_path / "a.inp")
    text = (tmp_path / "a.inp").read_text()
    found = re.findall(r"OGDEN, N=2\n([\d.e-]+),", text)
    assert len(found) == 20
    np.testing.assert_allclose(np.array(found, float), values.reshape(20, -1).mean(axis=1) / 2, rtol=1e-6)
    groups = re.findall(r"\*ELSET, ELSET=TISSUE_G\d\d\n((?:[\d, ]+\n)+)", text)
    members = [int(each) for each in itertools.chain(*(re.findall(r"\d+", group) for group in groups))]
    assert sorted(members) == list(range(1, n + 1))


def test_cells_that_differ_in_several_parameters_are_grouped_by_all_of_them():
    """Stiffness and exponent vary independently: groups by one of them would leave the other as it is."""
    rng = np.random.default_rng(7)
    rows = np.exp(0.3 * rng.standard_normal((600, 2)))
    group = _groups(rows)
    inner = [np.mean([np.var(np.log(rows[group == k, j])) for k in np.unique(group)]) for j in range(2)]
    assert max(inner) < 0.3 * 0.3**2


def test_what_abaqus_has_no_form_for_is_refused(tmp_path):
    for material in (Material("holmes_mow", {"mu": 1.0, "lambda": 1.0, "beta": 1.0}),
                     Material("viscoelastic", {"t1": 1.0, "g1": 0.5}, (OGDEN,))):  # fmt: skip
        model = replace(one_tetrahedron(), materials={"tissue": material})
        with pytest.raises(CaseError, match=f"{material.law}.*has no form"):
            write_abaqus(model, tmp_path / "a.inp")
        assert not (tmp_path / "a.inp").exists()
