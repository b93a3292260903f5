"""A liner on the skin: one layer of its thickness that conforms to it and resists as its law says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from small_models import block, top_facets
from stumps import DOWN, stump

from limbcli.errors import MeshError, SolveError
from limbcli.fem.system import System
from limbcli.meshing.quality import scaled_jacobians
from limbcli.meshing.surfaces import Triangles
from limbcli.model import LimbModel, Mesh, Surface
from limbcli.progress import Progress
from limbcli.sockets.centre_line import centre_line
from limbcli.sockets.checks import check_room, clearance
from limbcli.sockets.donning import DonningOptions, _explained, don_and_load
from limbcli.sockets.liner import LINER, LINER_INSIDE, TIGHT_MM, Liner, grown, with_liner
from tests.benchmarks import socket_febio_sleeve as sleeve

SOFT = Liner(thickness=3.0, youngs_modulus=0.3, poisson=0.45)


def lined(kind: str, *, bonded: bool = True) -> LimbModel:
    base = block(kind, (3, 3, 2), (12.0, 12.0, 6.0), material=SOFT.material)
    mesh = replace(base.mesh, surfaces={"skin": Surface("skin", top_facets(base))})
    return with_liner(replace(base, mesh=mesh), replace(SOFT, bonded=bonded))


@pytest.mark.parametrize("kind", ["tet4", "tet10"])
def test_an_even_strain_of_block_and_liner_has_no_force_inside(kind: str, rng: np.random.Generator) -> None:
    """Of one law they are one block: the patch test."""
    model = lined(kind)
    X = model.mesh.points
    system = System(model, threads=1)
    state = system.rest()
    state = replace(state, u=X @ (0.05 * rng.standard_normal((3, 3))))
    forces = system.forces(state).nodal
    inside = (X[:, :2].min(axis=1) > 1e-9) & (X[:, :2].max(axis=1) < 12 - 1e-9)
    inside &= (X[:, 2] > X[:, 2].min() + 1e-9) & (X[:, 2] < X[:, 2].max() - 1e-9)
    assert inside.any()
    np.testing.assert_allclose(forces[inside], 0.0, atol=1e-7 * np.abs(forces).max())
    assert X[:, 2].max() == pytest.approx(3.0)


@pytest.mark.parametrize("kind", ["tet4", "tet10"])
def test_one_that_slides_has_nodes_of_its_own_just_inside_the_skin(kind: str) -> None:
    bonded, free = lined(kind), lined(kind, bonded=False)
    (skin,), (inside,) = (free.mesh.surfaces[name].facets.values() for name in ("skin", LINER_INSIDE))
    cells = {each.name: np.unique(each.cells) for each in free.mesh.blocks}
    assert not np.intersect1d(cells["tissue"], cells[LINER]).size
    assert np.isin(inside, cells[LINER]).all()
    X = free.mesh.points
    np.testing.assert_allclose(X[inside].mean(axis=1) - X[skin].mean(axis=1), [[0, 0, -TIGHT_MM]] * len(skin))
    normals = [np.cross(X[f[:, 1]] - X[f[:, 0]], X[f[:, 2]] - X[f[:, 0]]) for f in (skin, inside)]
    np.testing.assert_allclose(normals[1], -normals[0])
    assert {len(np.unique(np.round(each.mesh.points, 1), axis=0)) for each in (bonded, free)} == {
        len(bonded.mesh.points)
    }


@pytest.mark.parametrize("bonded", [True, False])
def test_a_thin_one_is_as_curved_as_strongly_curved_skin(bonded: bool) -> None:
    """Edges of 4 mm that bulge by 0.8 mm, under 1 mm of liner."""
    base = block("tet10", (3, 3, 2), (12.0, 12.0, 6.0), material=SOFT.material)
    facets = top_facets(base)
    points = base.mesh.points.copy()
    points[np.unique(next(iter(facets.values()))[:, 3:]), 2] += 0.8
    mesh = replace(base.mesh, points=points, surfaces={"skin": Surface("skin", facets)})
    made = with_liner(replace(base, mesh=mesh), replace(SOFT, thickness=1.0, bonded=bonded)).mesh
    assert scaled_jacobians(made.points, made.block(LINER).cells).min() > 0


def test_its_facets_lie_over_the_skins_in_the_same_order() -> None:
    skin = stump()
    mesh = Mesh(skin.points, (), {}, {"skin": Surface("skin", {"tri3": skin.faces})})
    model = with_liner(LimbModel(mesh, {}, ()), SOFT)
    outer = Triangles(model.mesh.points, model.mesh.surfaces[LINER].facets["tri3"])
    away = outer.centroids - skin.centroids
    normal = skin.area_vectors / skin.areas[:, None]
    assert np.median((away * normal).sum(axis=1)) == pytest.approx(3.0, rel=0.01)
    with pytest.raises(MeshError, match="would fold"):
        with_liner(LimbModel(replace(mesh, points=-skin.points), {}, ()), replace(SOFT, thickness=49.0))


def test_a_liner_thicker_than_the_gap_is_refused() -> None:
    skin = stump()
    wall = grown(skin, 3.0)
    wall = wall.part(wall.centroids[:, 2] < 110.0).flipped()
    before = clearance(wall, skin, centre_line(skin, DOWN))
    check_room(before, skin, 4.0)
    with pytest.raises(MeshError, match="thicker than the gap") as caught:
        check_room(before, skin, 8.0)
    assert caught.value.fix


def test_a_liner_without_any_friction_is_named_where_there_is_no_equilibrium() -> None:
    """On a tapered sleeve that is open at both ends it slid 14 mm, and no load of 2 N was found."""
    slides = DonningOptions(friction=0.0, liner_slides=True, skin=LINER)
    stopped = SolveError("load step 2 of 2 stopped", where="node 7", fix="use more load steps")
    for n_states in (0, 1):
        assert "give the liner a friction" in _explained(stopped, n_states, slides).fix
        for held in (replace(slides, liner_friction=0.3), replace(slides, liner_slides=False)):
            assert "liner" not in _explained(stopped, n_states, held).fix


@pytest.mark.slow
@pytest.mark.parametrize("penetration_mm", [None, 0.1])
def test_a_liner_with_friction_on_both_faces_is_donned(penetration_mm: float | None) -> None:
    """Its upper end leaves the wall over a bend of 20 degrees; while traction jumped there and between stick
    and slip, donning ended without an equilibrium after 101 iterations."""
    limb, wall = sleeve.lined(sleeve.limb(tet10=False), sleeve.face(), "slides")
    options = DonningOptions(
        friction=0.3, loads_n=(), donning_steps=6, search_radius_mm=8.0, penetration_mm=penetration_mm,
        penalty=20.0, skin=LINER, liner_slides=True,
    )  # fmt: skip
    iterations = []
    listener = Progress(lambda kind, facts: iterations.append(kind == "newton" and facts["iteration"] > 0))
    result = don_and_load(limb, wall, options, threads=1, progress=listener)
    assert result.worst.share < 1e-6
    assert sum(iterations) < 40


@pytest.mark.slow
def test_a_liner_that_hardly_slides_is_nearly_a_bonded_one() -> None:
    """Friction 2 on the skin, and little penetration: what holds and what strains is then the same."""
    options = DonningOptions(
        loads_n=(),
        donning_steps=3,
        penalty=20.0,
        search_radius_mm=8.0,
        penetration_mm=0.04,
        skin=LINER,
        liner_friction=2.0,
    )
    found = {}
    for how in ("bonded", "slides"):
        limb, wall = sleeve.lined(sleeve.limb(tet10=False), sleeve.face(), how)
        result = don_and_load(limb, wall, replace(options, liner_slides=how == "slides"), threads=1)
        assert result.worst.share < 1e-4
        found[how] = result.states[0]
    bonded, slides = found["bonded"], found["slides"]
    assert slides.socket_force_n[2] == pytest.approx(bonded.socket_force_n[2], rel=0.06)
    n = int(sleeve.limb(tet10=False).mesh.blocks[0].cells.max()) + 1
    apart = slides.displacements[:n] - bonded.displacements[:n]
    assert np.linalg.norm(apart) < 0.15 * np.linalg.norm(bonded.displacements[:n])
    # on the skin less pressure than outside, by the ratio of the radii (22 to 20), and what penetration takes
    total = [(each.facet_pressure_mpa * each.facet_area_mm2).sum() for each in (slides, bonded)]
    assert 0.8 < total[0] / total[1] < 0.95
