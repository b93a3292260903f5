"""What is given and what follows: nodes of rigid bodies, nodes that two supports name, springs, turns."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
import pytest
from small_models import block, under_a_rigid_half

from limbcli.errors import SolveError
from limbcli.fem.analysis import Analysis, Snapshot
from limbcli.fem.equilibrium.settings import Settings
from limbcli.fem.motion.kinematics import Kinematics
from limbcli.fem.motion.rigid import AT_REST, Body, spring_forces
from limbcli.model import Support
from limbcli.model.bodies import Drive, RigidBody, Spring

QUICK = Settings(tolerance=1e-11, threads=1)


@pytest.mark.parametrize("kind", ["hex8", "tet4"])
def test_nodes_that_tissue_shares_with_a_rigid_block_move_with_it(kind: str) -> None:
    """As if they were tied to it."""
    model = under_a_rigid_half(kind)
    tied = replace(model, bodies=(replace(model.bodies[0], node_sets=("middle",)),))
    shared, expected = (Analysis(each, QUICK).run()[-1] for each in (model, tied))
    middle = model.mesh.node_sets["middle"]
    np.testing.assert_allclose(shared.state.u[middle], [[0.0, 0.0, -0.1]] * len(middle), atol=1e-12)
    assert expected.forces.bodies[0, 2] < -1e-3
    np.testing.assert_allclose(shared.forces.bodies, expected.forces.bodies, atol=1e-12)


@pytest.mark.parametrize("order", [1, -1])
def test_a_prescribed_displacement_stands_above_one_held_at_0(order: int) -> None:
    """On the edge that both node sets have, whichever stands first."""
    model = block("hex8", (1, 1, 1))
    supports = (Support("x0", ("x", "y", "z")), Support("z1", ("z",), -0.1, "ramp"))[::order]
    given = Kinematics(model, supports, None, None, [model.mesh.block("tissue").cells])
    u = given.prescribed(given.rest(), 0.5).u
    sets = model.mesh.node_sets
    np.testing.assert_array_equal(u[sets["z1"], 2], -0.05)
    np.testing.assert_array_equal(u[np.setdiff1d(sets["x0"], sets["z1"]), 2], 0.0)


@pytest.mark.parametrize(("free_length", "force"), [(4.0, 2.0), (0.0, 0.0)])
def test_a_spring_without_a_free_length_is_slack_at_the_start(free_length: float, force: float) -> None:
    spring = Spring("spring", "a", "b", 2.0, (0.0, 0.0, 0.0), (0.0, 3.0, 4.0), free_length)
    nodes = np.zeros(0, dtype=np.int64)
    ends = {name: (Body(name, np.zeros(3), {}, nodes, nodes), AT_REST) for name in "ab"}
    on_a, on_b, _ = spring_forces(spring, ends)
    np.testing.assert_allclose(on_a[:3], [0.0, 0.6 * force, 0.8 * force], atol=1e-15)
    np.testing.assert_array_equal(on_b[:3], -on_a[:3])


def test_a_prescribed_displacement_of_a_rigid_bodys_nodes_is_refused() -> None:
    """It would do nothing. One held at 0 does nothing either, and FEBio lets it pass."""
    model = under_a_rigid_half("hex8")
    for node_set in ("middle", "z1"):
        Kinematics(model, (Support(node_set, ("x",)),), None, None, [])
        with pytest.raises(SolveError, match=f"4 nodes of '{node_set}' .* the rigid body 'plate'"):
            Kinematics(model, (Support(node_set, ("x",), 0.1, "ramp"),), None, None, [])


def test_a_cube_that_a_rigid_plate_holds_whole_is_pressed_by_a_force() -> None:
    """No node of it is free: the plate alone has an equation. As far as by a displacement of that force."""
    cube = replace(
        block("hex8", (1, 1, 1)),
        bodies=(RigidBody("plate", (0.5, 0.5, 0.0), node_sets=("z1",)),),
        supports=(Support("z0", ("x", "y", "z")),),
    )
    held = tuple(Drive("plate", dof, "fixed") for dof in ("x", "y", "u", "v", "w"))  # type: ignore[arg-type]

    def pressed(kind: Literal["displacement", "force"], value: float) -> Snapshot:
        return Analysis(replace(cube, drives=(*held, Drive("plate", "z", kind, value, "ramp"))), QUICK).run()[
            -1
        ]

    force = pressed("displacement", -0.1).forces.bodies[0, 2]
    assert force < -1e-3
    assert pressed("force", force).state.bodies[0].shift[2] == pytest.approx(-0.1, rel=1e-9)
