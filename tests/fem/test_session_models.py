"""What a session solves beside its own model: other materials and load curves, and nothing else."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest
from small_models import punch

from limbcli.errors import CaseError, SolveError
from limbcli.materials import ogden_type
from limbcli.model import Curve, LimbModel, LogRecord, Material, Support
from limbcli.solvers.session import ReferenceSession


def small(depth: float = 0.6) -> LimbModel:
    return punch("tet4", (3, 2, 2), depth=depth, levels=1)


@pytest.mark.parametrize(
    ("what", "change"),
    [
        ("contacts", lambda m: replace(m, contacts=tuple(replace(c, friction=0.3) for c in m.contacts))),
        ("contacts", lambda m: replace(m, contacts=tuple(replace(c, penalty=2.0) for c in m.contacts))),
        ("mesh", lambda m: replace(m, mesh=replace(m.mesh, points=1.1 * m.mesh.points))),
        ("drives", lambda m: replace(m, drives=small(0.9).drives)),
        ("supports", lambda m: replace(m, supports=(*m.supports, Support("x0", ("x",))))),
    ],
)
def test_another_set_up_is_refused(what: str, change: Callable[[LimbModel], LimbModel]) -> None:
    """The first model's force had been given for it; the session goes on."""
    with closing(ReferenceSession(small(), threads=1)) as session:
        before = session.solve().must_points.forces
        with pytest.raises(CaseError, match=f"differs in its {what}"):
            session.solve(change(small()))
        np.testing.assert_array_equal(session.solve().must_points.forces, before)


def with_step(model: LimbModel, **change: object) -> LimbModel:
    return replace(model, steps=tuple(replace(each, **change) for each in model.steps))


@pytest.mark.parametrize(
    ("what", "change"),
    [
        ("does not resist deformation", lambda m: m.with_material("tissue", LIMP)),
        ("transient analysis", lambda m: with_step(m, analysis="transient")),
        ("arc-length", lambda m: with_step(m, control={"arc_length": 1})),
        ("'vx' is not supported", lambda m: replace(m, records=(LogRecord("node", ("vx",), "v.csv", None),))),
    ],
)
def test_what_a_session_would_not_begin_with_is_refused_later_too(
    what: str, change: Callable[[LimbModel], LimbModel]
) -> None:
    """Limp tissue had given a force of -0 N, and inertia had been left out."""
    with closing(ReferenceSession(small(), threads=1)) as session:
        before = session.solve().must_points.forces
        with pytest.raises(SolveError, match=what):
            session.solve(change(small()), records=True)
        np.testing.assert_array_equal(session.solve().must_points.forces, before)


def test_a_name_that_the_model_does_not_have_is_told_with_those_it_has() -> None:
    with pytest.raises(SolveError, match="no rigid body 'prob'") as found:
        ReferenceSession(small(), threads=1, body="prob")
    assert "use one of probe" in str(found.value)
    session = ReferenceSession(small(), threads=1)
    with closing(session), pytest.raises(SolveError, match="no material 'skin'") as found:
        session.solve(wrt=[("skin", "c1")])
    assert "use one of tissue" in str(found.value)


LIMP = Material("ogden", {"c1": -0.005, "m1": 2.0, "kappa": 0.05})


def test_the_same_model_read_anew_with_other_materials_and_curves_is_solved() -> None:
    stiffer = small().with_material("tissue", ogden_type(c=0.01, f_kappa=5.0, m=2.0))
    late = replace(stiffer, curves={"ramp": Curve(((0.0, 0.0), (0.5, 0.0), (1.0, 1.0)))})
    with closing(ReferenceSession(small(), threads=1)) as session:
        forces = [session.solve(each).must_points.forces[-1] for each in (None, stiffer, late)]
    assert forces[1:] == pytest.approx([2 * forces[0]] * 2, rel=1e-5)


def test_the_penalty_of_a_relaxing_law_is_that_of_the_steps_that_are_solved() -> None:
    """It is as stiff as the law in its first step, however long that of an earlier model was."""
    relaxing = Material("viscoelastic", {"g1": 2.0, "t1": 0.3}, (ogden_type(c=0.005, f_kappa=5.0, m=2.0),))
    coarse = small().with_material("tissue", relaxing)
    fine = replace(coarse, steps=(replace(coarse.steps[0], n_steps=20, step_size=0.05),))
    forces = []
    for before in ((), (coarse,)):
        with closing(ReferenceSession((*before, fine)[0], threads=1)) as session:
            for each in before:
                session.solve(each)
            forces.append(session.solve(fine).must_points.forces)
    np.testing.assert_allclose(forces[1], forces[0], rtol=1e-6)
