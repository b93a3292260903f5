"""Derivatives of everything that is logged, against central differences of whole solves (1e-5)."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest
from small_models import block, punch, under_a_rigid_half

from limbcli.errors import SolveError
from limbcli.fem.analysis import Analysis
from limbcli.fem.derivatives.field_derivatives import (
    cell_field_derivatives,
    principal_changes,
    record_derivatives,
)
from limbcli.fem.derivatives.parameters import LawParameter, Parameter, Prestrain
from limbcli.fem.derivatives.sensitivity import sensitivities
from limbcli.fem.equilibrium.settings import Settings
from limbcli.fem.record_fields import BODY_FIELDS, CELL_FIELDS, NODE_FIELDS, record_rows
from limbcli.materials import compile_material, ogden_type
from limbcli.model import Block, Curved, Domain, ElementMap, LimbModel, LogRecord, Material, Step, Support
from limbcli.model.bodies import Drive, RigidBody, Spring
from limbcli.solvers.session import ReferenceSession

TIGHT = Settings(tolerance=1e-12, threads=1)
PLAIN = ogden_type(c=0.0052, f_kappa=7.3, m=3.1)
ALONG = (0.0, 0.6, 0.8)
TAUT = tuple(np.diag([1.04, 1.02, 0.96]).ravel().tolist())
FIBRES = Material(
    "fiber_exp_pow",
    {"ksi": 0.02, "alpha": 0.3, "beta": 2.4, "mu": 0.004, "lam0": 0.8, "fiber": ALONG},
)
# (law, its parameters with the path to their owner)
LAWS = {
    "ogden": (PLAIN, ("c1", "m1", "c2", "m2", "kappa")),
    "mooney-rivlin": (
        Material("mooney_rivlin", {"c1": 0.0011, "c2": 0.0004, "kappa": 0.05}),
        ("c1", "c2", "kappa"),
    ),
    "ogden uncoupled": (
        Material("ogden_uncoupled", {"c1": 0.002, "m1": 3.0, "c2": 0.001, "m2": -4.0, "kappa": 0.05}),
        ("c1", "m1", "c2", "m2", "kappa"),
    ),
    "neo-hooke": (Material("neo_hooke", {"mu": 0.002, "lambda": 0.03}), ("mu", "lambda")),
    "holmes-mow": (
        Material("holmes_mow", {"mu": 0.002, "lambda": 0.01, "beta": 0.6}),
        ("mu", "lambda", "beta"),
    ),
    "fibres": (
        Material("mixture", {}, (PLAIN, FIBRES)),
        ("0.c1", "0.m2", "1.ksi", "1.alpha", "1.beta", "1.mu", "1.lam0"),
    ),
    "contraction": (
        Material("mixture", {}, (PLAIN, Material("active_contraction", {"T0": 0.001, "fiber": ALONG}))),
        ("0.kappa", "1.T0"),
    ),
    "prestrain": (Material("prestrain", {"F0": TAUT, "ramp": 0.7}, (PLAIN,)), ("c1", "m1", "kappa")),
    "viscoelastic": (
        Material("viscoelastic", {"g1": 0.8, "t1": 0.5}, (PLAIN,)),
        ("c1", "m1", "kappa"),
    ),
}


def small(material: Material = PLAIN, kind: str = "tet4") -> LimbModel:
    """Pressed by 0.6 mm in one step."""
    model = punch(kind, (3, 2, 2), depth=0.6, levels=1, material=material)
    return replace(model, steps=(Step(n_steps=1, step_size=1.0, adaptive=False),))


def moved(material: Material, name: str, change: float) -> Material:
    """The material with a number of it, or of a part of it, changed."""
    first, _, rest = name.rpartition(".")
    if first or (name not in material.parameters and material.parts):
        k = int(first or 0)
        part = moved(material.parts[k], rest, change)
        return replace(material, parts=(*material.parts[:k], part, *material.parts[k + 1 :]))
    return material.with_parameters(**{name: float(material.parameters[name]) + change})


def value(material: Material, name: str) -> float:
    leaf, key = compile_material(material, "tissue").find(name)
    return float(leaf.parameters[key])


def check(
    parameter: Parameter,
    change: Callable[[float], LimbModel],
    h: float,
    *,
    records: tuple[LogRecord, ...] = (
        LogRecord("element", CELL_FIELDS, "cells"),
        LogRecord("rigid_body", BODY_FIELDS, "probe", "probe"),
    ),
    atol: float = 1e-5,
) -> None:
    """Every field of the records: its derivative is the central difference of whole solves."""

    def rows(step: float, wanted: Parameter | None) -> list[np.ndarray]:
        with closing(Analysis(change(step), TIGHT)) as analysis:
            last = analysis.run()[-1]
            system, state, forces = analysis.system, last.state, last.forces
            if wanted is None:
                return [record_rows(system, state, forces, each)[1] for each in records]
            (found,) = sensitivities(analysis.newton, state, forces, [wanted])
            return [record_derivatives(system, state, each, wanted, found)[1] for each in records]

    ends = zip(records, rows(0.0, parameter), rows(h, None), rows(-h, None), strict=True)
    for record, exact, up, down in ends:
        numeric = (up - down) / (2 * h)
        sizes = abs(numeric).max(axis=0)
        kinds = np.array([name[0].replace("M", "F") for name in record.fields])
        largest = np.array([sizes[kinds == kind].max() for kind in kinds])  # of tensors' components
        scale = np.maximum(sizes, np.maximum(1e-2 * largest, 1e-6))
        worst = abs(exact - numeric).max(axis=0) / scale
        bends = {f"{letter}{k}" for letter in "EU" for k in (1, 2, 3)}  # where two principal values are near
        worst = worst / [100.0 if name in bends else 1.0 for name in record.fields]
        wrong = {name: error for name, error in zip(record.fields, worst, strict=True) if not error < atol}
        assert not wrong, record.file


@pytest.mark.slow
@pytest.mark.parametrize("law", LAWS)
def test_cell_and_body_fields_by_all_numbers_of_a_law(law: str, rng: np.random.Generator) -> None:
    """All numbers of the law together, each at a random rate."""
    material, names = LAWS[law]
    rates = {name: value(material, name) * rng.uniform(0.5, 1.5) * rng.choice([-1, 1]) for name in names}

    def change(h: float) -> LimbModel:
        now = material
        for name, rate in rates.items():
            now = moved(now, name, h * rate)
        return small(now)

    parameter = LawParameter("tissue", rates)
    fields = tuple(each for each in CELL_FIELDS if law != "viscoelastic" or each != "sed")
    body = LogRecord("rigid_body", BODY_FIELDS, "probe", "probe")
    check(parameter, change, 1e-5, records=(LogRecord("element", fields, "cells"), body))


def test_the_logged_energy_of_a_viscoelastic_law_has_no_derivative() -> None:
    with closing(Analysis(small(LAWS["viscoelastic"][0]), TIGHT)) as analysis:
        last = analysis.run()[-1]
        parameter = LawParameter("tissue", {"c1": 1.0})
        (found,) = sensitivities(analysis.newton, last.state, last.forces, [parameter])
        with pytest.raises(SolveError, match="energy of a viscoelastic law"):
            record_derivatives(
                analysis.system, last.state, LogRecord("element", ("sed",), "cells"), parameter, found
            )


@pytest.mark.parametrize(("name", "h"), [("1.lam0", 1e-5), ("1.mu", 1e-5), ("1.alpha", 1e-4), ("0.m1", 1e-5)])
def test_fields_with_tet10_by_a_number_of_a_mixture(name: str, h: float) -> None:
    law = LAWS["fibres"][0]
    size = value(law, name)
    parameter = LawParameter("tissue", {name: size})
    cells = (LogRecord("element", CELL_FIELDS, "cells"),)
    check(parameter, lambda step: small(moved(law, name, step * size), "tet10"), h, records=cells)


def by_ramp() -> tuple[Prestrain, Callable[[float], LimbModel]]:
    def change(h: float) -> LimbModel:
        return small(Material("prestrain", {"F0": TAUT, "ramp": Curved(0.7 + h, "ramp")}, (PLAIN,)))

    return Prestrain("tissue"), change


def by_prestrain() -> tuple[Prestrain, Callable[[float], LimbModel]]:
    direction = np.random.default_rng(7).standard_normal((3, 3))

    def change(h: float) -> LimbModel:
        F0 = tuple((np.reshape(TAUT, (3, 3)) + h * direction).ravel().tolist())
        return small(Material("prestrain", {"F0": F0, "ramp": 0.7}, (PLAIN,)))

    return Prestrain("tissue", direction), change


def by_map() -> tuple[LawParameter, Callable[[float], LimbModel]]:
    rng = np.random.default_rng(7)
    n = len(small().mesh.block("tissue").cells)
    base, weights = 3.1 * (1 + 0.1 * rng.uniform(size=n)), rng.uniform(size=n)

    def change(h: float) -> LimbModel:
        return small(PLAIN.with_parameters(m1=ElementMap("m1", "tissue", base + h * weights)))

    return LawParameter("tissue", {"m1": 1.0}, weights=weights), change


def by_a_regions_stiffness() -> tuple[LawParameter, Callable[[float], LimbModel]]:
    """Two blocks each with its own stiffness: the lower one's is moved."""
    model = small()
    tissue = model.mesh.block("tissue")
    deep = model.mesh.points[tissue.cells].mean(axis=1)[:, 2] < -4.0
    blocks = (
        Block("tissue", tissue.kind, tissue.cells[~deep]),
        *(each for each in model.mesh.blocks if each.name != "tissue"),
        Block("deep", tissue.kind, tissue.cells[deep]),
    )

    def change(h: float) -> LimbModel:
        law = PLAIN.with_parameters(c1=PLAIN.parameters["c1"] * (1 + h))
        return replace(
            model,
            mesh=replace(model.mesh, blocks=blocks),
            materials={**model.materials, "tissue": PLAIN, "own": law},
            domains=(*model.domains, Domain("deep", "own")),
        )

    return LawParameter("own", {"c1": PLAIN.parameters["c1"]}), change


def on_a_spring(law: Material = PLAIN) -> LimbModel:
    """Pressed from below against a bone that is tied to it and hangs on springs; one side is driven."""
    model = block("tet4", (3, 2, 2), (12.0, 10.0, 8.0), material=law)
    ends = ((6.0, 5.0, 3.0), (9.0, 2.0, 1.0), (2.0, 8.0, 2.0))
    away = tuple((x + 4.0, y - 3.0, z + 9.0) for x, y, z in ends)
    springs = tuple(
        Spring(f"s{k}", "bone", "wall", 0.05, a, b, float(np.linalg.norm(np.subtract(a, b))))
        for k, (a, b) in enumerate(zip(ends, away, strict=True))
    )
    return replace(
        model,
        bodies=(RigidBody("bone", (6.0, 5.0, 1.0), (), ("z1",)), RigidBody("wall", (6.0, 5.0, 12.0))),
        supports=(Support("z0", ("x", "y")), Support("z0", ("z",), 0.9, "ramp")),
        drives=tuple(Drive("wall", dof, "fixed") for dof in "xyzuvw"),
        springs=springs,
        steps=(Step(n_steps=1, step_size=1.0),),
    )


def by_law_on_a_spring() -> tuple[LawParameter, Callable[[float], LimbModel]]:
    size = float(PLAIN.parameters["kappa"])

    def change(h: float) -> LimbModel:
        return on_a_spring(PLAIN.with_parameters(kappa=size * (1 + h)))

    return LawParameter("tissue", {"kappa": size}), change


def by_law_under_a_force() -> tuple[LawParameter, Callable[[float], LimbModel]]:
    """The probe's depth is an answer, and its own nodes move with it."""
    drives = (
        *(Drive("probe", dof, "fixed") for dof in ("x", "y", "u", "v", "w")),
        Drive("probe", "z", "force", -0.03, "ramp"),
    )

    def change(h: float) -> LimbModel:
        law = PLAIN.with_parameters(c1=PLAIN.parameters["c1"] * (1 + h))
        return replace(small(law), drives=drives, steps=(Step(n_steps=10, step_size=0.1),))

    return LawParameter("tissue", {"c1": PLAIN.parameters["c1"]}), change


CASES = {
    each.__name__: each
    for each in (
        by_ramp, by_prestrain, by_map, by_a_regions_stiffness, by_law_on_a_spring, by_law_under_a_force,
    )
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_every_field_of_every_record(case: str) -> None:
    """Of cells, nodes (with reactions) and bodies."""
    parameter, change = CASES[case]()
    names = [body.name for body in change(0.0).bodies]
    fields = dict.fromkeys(names, BODY_FIELDS)
    if case == "by_law_under_a_force":  # it is given
        fields["probe"] = tuple(name for name in BODY_FIELDS if name != "Fz")
    if "wall" in names:  # the bone's balance is 0
        fields["bone"] = BODY_FIELDS[:6]
    records = (
        LogRecord("element", CELL_FIELDS, "cells"),
        LogRecord("node", NODE_FIELDS, "nodes"),
        *(LogRecord("rigid_body", fields[name], name, name) for name in names),
    )
    check(parameter, change, 1e-4, records=records)


def test_nodes_of_tissue_that_a_rigid_block_shares_move_once() -> None:
    """With a body that a force moves."""
    model = under_a_rigid_half("hex8")
    pressed = Drive("plate", "z", "force", -0.002, "ramp")
    model = replace(model, drives=(*model.drives[:-1], pressed))

    def change(h: float) -> LimbModel:
        return model.with_material("tissue", moved(model.materials["tissue"], "c1", h))

    check(
        LawParameter("tissue", {"c1": 1.0}), change, 1e-6, records=(LogRecord("node", ("z", "uz"), "nodes"),)
    )


def test_equal_principal_stresses_change_by_those_within_their_plane(rng: np.random.Generator) -> None:
    """To second order in the step, in any frame, for two, three or no equal ones."""
    for values in ([2.0, 1.0, 1.0], [2.0, 2.0, 1.0], [1.0, 1.0, 1.0], [0.0, 0.0, 0.0], [3.0, 1.0, -1.0]):
        Q = np.linalg.qr(rng.standard_normal((3, 3)))[0]
        S, dS = Q @ np.diag(values) @ Q.T, rng.standard_normal((3, 3))
        dS, h = dS + dS.T, 1e-6
        forward = (np.linalg.eigvalsh(S + h * dS) - np.linalg.eigvalsh(S))[::-1] / h
        np.testing.assert_allclose(principal_changes(S[None], dS[None])[0], forward, atol=3e-5)


def test_unloaded_tissue_has_derivatives_of_nothing() -> None:
    """No stress yet: principal stresses all equal, all derivatives finite."""
    model = replace(on_a_spring(), supports=(Support("z0", ("x", "y", "z")),))
    with closing(Analysis(model, TIGHT)) as analysis:
        last = analysis.run()[-1]
        parameter = LawParameter("tissue", {"c1": 1.0})
        (found,) = sensitivities(analysis.newton, last.state, last.forces, [parameter])
        rows = cell_field_derivatives(
            analysis.system, last.state, 0, ("s1", "s2", "s3", "sed", "J"), parameter, found
        )
    np.testing.assert_allclose(rows, 0.0, atol=1e-9)


@pytest.mark.parametrize("why", ["augmented", "viscoelastic"])
def test_a_response_that_depends_on_the_way_is_refused(why: str) -> None:
    model = small(LAWS["viscoelastic"][0]) if why == "viscoelastic" else small()
    if why == "viscoelastic":
        model = replace(model, steps=(Step(n_steps=2, step_size=0.5),))
    else:
        model = replace(model, contacts=(replace(model.contacts[0], augmented=True),))
    with closing(Analysis(model, Settings(threads=1))) as analysis:
        last = analysis.run()[-1]
        with pytest.raises(SolveError, match="depends on the loading path"):
            sensitivities(analysis.newton, last.state, last.forces, [LawParameter("tissue", {"c1": 1.0})])


@pytest.mark.parametrize(
    ("parameter", "words"),
    [
        (LawParameter("tissue", {"c1": 1.0}, weights=np.ones(3)), "3 weights for the 72 cells"),
        (LawParameter("fat", {"c1": 1.0}), "no region is made of 'fat'"),
        (LawParameter("tissue", {"q": 1.0}), "no parameters 'q'"),
        (Prestrain("tissue"), "has a prestrain"),
    ],
)
def test_a_parameter_that_is_not_there_is_refused_by_name(parameter: Parameter, words: str) -> None:
    with closing(Analysis(small(), Settings(threads=1))) as analysis:
        last = analysis.run()[-1]
        with pytest.raises(SolveError, match=words):
            sensitivities(analysis.newton, last.state, last.forces, [parameter])


@pytest.mark.parametrize("law", ["fibres", "viscoelastic"])
def test_a_session_differentiates_all_that_is_logged(law: str) -> None:
    """Exactly, or by differences where the response depends on the way, and says which."""
    material, name = LAWS[law][0], "0.c1" if law == "fibres" else "c1"
    records = (
        LogRecord("element", ("sed", "s1", "cxxyy"), "cells.csv", np.array([3, 8])),
        LogRecord("node", ("ux", "z"), "nodes.csv"),
    )
    model = replace(
        punch(depth=0.6, levels=3, n=(3, 2, 2), material=material),
        records=records,
        steps=(Step(n_steps=3, step_size=1 / 3, must_points=(0.5,)),),
    )
    h = 1e-3 * value(material, name)
    with closing(ReferenceSession(model, threads=1, tolerance=1e-11)) as session:
        ends = [
            session.solve(model.with_material("tissue", moved(material, name, step)), records=True)
            for step in (h, -h)
        ]
        result = session.solve(model, wrt=[("tissue", name)], field_gradients=True)
    assert result.differenced == (law == "viscoelastic")
    found = result.field_gradient["tissue", name]
    assert set(found) == {"cells.csv", "nodes.csv", "probe"}
    assert found["cells.csv"].times.tolist() == result.must_points.times.tolist()
    assert found["probe"].column("Fz")[:, 0] == pytest.approx(-result.force_gradient["tissue", name])
    for kind, key in (("elements", "cells.csv"), ("nodes", "nodes.csv"), ("rigid", "probe")):
        up, down = (getattr(each.simulation, kind)[key] for each in ends)
        levels = np.isin(up.times, found[key].times)
        numeric = (up.values - down.values)[levels] / (2 * h)
        scale = abs(numeric).max(axis=(0, 1)) + 1e-3 * abs(numeric).max()
        np.testing.assert_allclose(found[key].values / scale, numeric / scale, atol=1e-5)
