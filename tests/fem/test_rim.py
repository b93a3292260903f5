"""Where a rigid surface ends: tractions fade, so that there is an equilibrium."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from small_models import punch

from limbcli.fem.analysis import Analysis
from limbcli.fem.contacts.contact_points import GAP, TRACTION, WEIGHT
from limbcli.fem.contacts.pairs import rim_widths
from limbcli.fem.equilibrium.settings import Settings
from limbcli.fem.equilibrium.tangent import assemble
from limbcli.fem.motion.rigid import BodyState
from limbcli.fem.motion.state import State
from limbcli.fem.system import System
from limbcli.model import LimbModel

NARROW = 6.3  # mm: a plate whose rim lies on the block


def pressed(kind: str = "tet4", **options: float) -> tuple[System, LimbModel]:
    model = punch(kind, (4, 3, 3), width=NARROW, **options)  # type: ignore[arg-type]
    return System(model, threads=1), model


def with_fade(system: System, part: float) -> None:
    """A rim that fades over so large a part of the plate that many points lie in it."""
    pair = system.pairs[0]
    pair.rim = np.where(pair.rim > 0, part, 0.0)


@pytest.mark.parametrize("kind", ["tet4", "tet10", "hex8"])
def test_tangent_agrees_with_differences_in_the_fade(kind: str, rng: np.random.Generator) -> None:
    system, _ = pressed(kind)
    with_fade(system, 0.5)
    state = system.prescribed(system.rest(), 0.3)
    state = system.moved(state, 2e-2 * rng.standard_normal(system.n_unknowns))
    forces = system.forces(state)
    weights = np.concatenate(
        [points[points[..., TRACTION] > 0][:, WEIGHT] for points in forces.contact.points[0]]
    )
    assert ((weights > 0.05) & (weights < 0.95)).sum() > 3, "points in the fade"
    direction = rng.standard_normal(system.n_unknowns)
    exact = assemble(system, state, forces.nodal).times(forces.contact, direction)
    rows = np.arange(system.n_tissue)
    matrix = system.contact_matrix(forces.contact, np.append(rows, -1)[system.equations], system.n_tissue)
    np.testing.assert_allclose(
        matrix @ direction, system.contact_change(forces.contact, direction)[: system.n_tissue], atol=1e-12
    )
    h = 1e-7
    up, down = (system.forces(system.moved(state, s * h * direction)).residual for s in (1, -1))
    np.testing.assert_allclose((up - down) / (2 * h), exact, atol=2e-6 * abs(exact).max())


@pytest.mark.slow
def test_a_traction_does_not_jump_as_a_point_passes_the_rim() -> None:
    """The block shifted under the plate by small steps: the force changes by small ones."""
    system, _ = pressed("hex8")
    state = system.prescribed(system.rest(), 0.5)
    way, sums = np.linspace(0.0, 2.0, 2001), []
    for shift in way:
        moved = replace(state, u=state.u + np.where(system.coupled[:, None], [shift, 0.0, 0.0], 0.0))
        sums.append(system.forces(moved).bodies[0, 2])
    force = np.abs(np.array(sums))
    assert np.ptp(force) > 0.05 * force.max(), "points do pass"
    steps = np.abs(np.diff(force))
    # a point has at most 1/9 of a facet's force, and fades over 0.06 of its size: some 0.2 mm
    assert steps.max() < 0.02 * force.max()


def test_tractions_are_as_ever_away_from_the_rim() -> None:
    system, _ = pressed("tet10")
    points = system.search(system.prescribed(system.rest(), 0.5)).points[0][0]
    patch = system.pairs[0].patches[0]
    inside = points[..., WEIGHT] == 1.0
    touched = points[..., TRACTION] > 0
    assert (inside & touched).sum() > 0.8 * touched.sum()
    plain = (patch.eps[:, None] * points[..., GAP])[inside & touched]
    np.testing.assert_allclose(points[..., TRACTION][inside & touched], plain, rtol=1e-12)


def test_only_edges_of_one_facet_end_a_surface() -> None:
    points = np.array([[x, y, 0.0] for y in (0.0, 1.0) for x in (0.0, 1.0, 2.0)] + [[3.0, 0.5, 0.0]])
    facets = np.array([[0, 1, 4, 3], [1, 2, 5, 4], [2, 6, 5, -1]])
    system, _ = pressed()
    found = rim_widths(points, facets, system.pairs[0].patches) > 0
    expected = [[True, False, True, True], [True, False, True, False], [True, True, False, False]]
    np.testing.assert_array_equal(found, expected)


def test_skin_is_pressed_up_to_the_rim_and_beyond() -> None:
    """A flat plate with no wall: the tissue beside it stands above its rim."""
    model = punch("tet10", (4, 3, 3), depth=2.5, levels=4, width=NARROW)
    snapshots = Analysis(model, Settings(tolerance=1e-8, threads=1)).run()
    assert [round(s.state.time, 9) for s in snapshots] == [0.25, 0.5, 0.75, 1.0]
    forces = [-s.forces.bodies[0, 2] for s in snapshots]
    assert (np.diff(forces) > 0).all()


def under(system: System, depth: float, shift: float) -> State:
    """The plate at a depth in the block, which is shifted sideways under it."""
    at_rest = system.rest()
    plate = BodyState(np.array([0.0, 0.0, -depth]), np.zeros(3))
    u = at_rest.u + np.where(system.coupled[:, None], [shift, 0.0, 0.0], 0.0)
    return system.followed(replace(at_rest, u=u, bodies=(plate,)))


def rough() -> System:
    _, model = pressed("hex8")
    contacts = tuple(replace(each, friction=0.3, symmetric=False) for each in model.contacts)
    return System(replace(model, contacts=contacts), threads=1)


def test_a_point_touches_no_deeper_than_it_can_have_come() -> None:
    """As where skin bulges over a brim: points that pass the rim sideways meet a face far below them."""
    system, fresh = rough(), rough()
    before = system.search(under(system, 3.0, 0.0)).touching
    assert before.any(), "an overlap at the beginning is contact"
    system.remember(under(system, 3.0, 0.0))
    passed = {shift: fresh.search(under(fresh, 3.0, shift)).touching & ~before for shift in (1.0, 2.0)}
    assert passed[1.0].any()
    assert not (system.search(under(system, 3.0, 1.0)).touching & ~before).any()
    np.testing.assert_array_equal(system.search(under(system, 3.0, 2.0)).touching & ~before, passed[2.0])
    system.remember(under(system, 3.0, 1.0))
    assert not (system.search(under(system, 3.0, 1.5)).touching & ~before).any(), "nor in the step after"


def test_a_plate_that_comes_from_above_touches_at_any_depth() -> None:
    system = rough()
    fresh = system.search(under(system, 3.0, 0.0)).touching
    system.remember(under(system, -0.1, 0.0))
    np.testing.assert_array_equal(system.search(under(system, 3.0, 0.0)).touching, fresh)
