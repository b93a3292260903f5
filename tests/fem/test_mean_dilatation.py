"""Hexahedra and wedges of an uncoupled law: FEBio's three-field element, with one pressure in each cell."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_models import block, punch

from limbcli.errors import CaseError
from limbcli.feb.read import read_feb
from limbcli.feb.write import write_feb
from limbcli.fem.analysis import Analysis
from limbcli.fem.equilibrium.settings import Settings
from limbcli.fem.record_fields import cell_fields
from limbcli.model import Domain, LimbModel, Material, Step, Support
from limbcli.solvers.session import ReferenceSession

TIGHT = Settings(tolerance=1e-11, threads=1)
LAWS = {
    "mooney-rivlin": Material("mooney_rivlin", {"c1": 0.002, "c2": 0.001, "kappa": 1.0}),
    "ogden": Material("ogden_uncoupled", {"c1": 0.004, "m1": 6.0, "kappa": 0.5}),
}
FIELDS = ("sx", "sy", "sz", "sxy", "syz", "sxz", "sed", "J")
# Norm of all displacements, and FIELDS of the first cell, of `sheared`: FEBio 4.11 with dtol 1e-10.
FEBIO = {
    ("hex8", "mooney-rivlin"): (
        1.17372914,
        (
            1.5986916e-3, 1.2930597e-3, -1.7067123e-3, -2.7308713e-5,
            -4.7568084e-4, 1.2951441e-3, 4.3290535e-3, 0.99768153,
        ),
    ),
    ("hex8", "ogden"): (
        1.17334285,
        (
            4.9323325e-4, 3.9909249e-4, -4.5310165e-4, -8.1745565e-5,
            -1.8439923e-4, 4.2736239e-4, 2.1125445e-3, 0.99758714,
        ),
    ),
    ("penta6", "mooney-rivlin"): (
        1.16502145,
        (
            1.3752547e-3, 1.0680842e-3, -2.0589121e-3, -9.6530062e-5,
            -5.7525629e-4, 1.5500861e-3, 4.3548209e-3, 0.996091,
        ),
    ),
    ("penta6", "ogden"): (
        1.16408592,
        (
            3.2103981e-4, 2.1210882e-4, -6.6314717e-4, -1.3563162e-4,
            -2.1467126e-4, 4.8641576e-4, 2.0617939e-3, 0.99586304,
        ),
    ),
}  # fmt: skip


def sheared(kind: str, material: Material, rule: str | None = None) -> LimbModel:
    """A distorted unit block whose top moves by 0.3 mm sideways and 0.15 mm down."""
    supports = (
        Support("z0", ("x", "y", "z")), Support("z1", ("y",)),
        Support("z1", ("x",), 0.3, "ramp"), Support("z1", ("z",), -0.15, "ramp"),
    )  # fmt: skip
    model = block(kind, material=material, twist=0.12)
    return replace(
        model,
        supports=supports,
        domains=(Domain("tissue", "tissue", rule),),
        steps=(Step(n_steps=4, step_size=0.25),),
    )


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "law"), FEBIO)
def test_displacements_stresses_and_energy_are_febios(kind: str, law: str) -> None:
    analysis = Analysis(sheared(kind, LAWS[law]), TIGHT)
    last = analysis.run()[-1]
    norm, fields = FEBIO[kind, law]
    assert np.linalg.norm(last.state.u) == pytest.approx(norm, rel=1e-8)
    np.testing.assert_allclose(cell_fields(analysis.system, last.state, 0, FIELDS)[0], fields, rtol=1e-7)


def test_bending_of_nearly_incompressible_hexahedra_does_not_lock() -> None:
    """A held block under shear: the same cells with a pressure at every point are several times as stiff."""
    stiff = Material("mooney_rivlin", {"c1": 0.002, "c2": 0.0, "kappa": 100.0})

    def force(rule: str | None) -> float:
        analysis = Analysis(sheared("hex8", stiff, rule), TIGHT)
        forces = analysis.run()[-1].forces
        return float(np.linalg.norm(forces.nodal[analysis.model.mesh.node_sets["z1"]].sum(axis=0)))

    assert force("elastic-solid") > 3 * force(None)


def test_a_mixture_has_its_pressure_at_every_point() -> None:
    """FEBio's three-field element needs a material that is itself an uncoupled law."""
    mixture = Material("mixture", {}, parts=(LAWS["ogden"],))
    alone, mixed, plain = (
        Analysis(sheared("hex8", material, rule), TIGHT).run()[-1].state.u
        for material, rule in ((LAWS["ogden"], None), (mixture, None), (LAWS["ogden"], "elastic-solid"))
    )
    np.testing.assert_allclose(mixed, plain, atol=1e-9)
    assert abs(alone - plain).max() > 1e-3


def test_contact_of_uncoupled_hexahedra_is_solved_and_differentiated() -> None:
    """The derivative of the force by the bulk modulus against a difference of whole solves."""
    model = punch(
        "hex8", material=replace(LAWS["ogden"], parameters={**LAWS["ogden"].parameters, "kappa": 0.05})
    )

    def force(kappa: float) -> float:
        law = model.materials["tissue"]
        changed = replace(law, parameters={**law.parameters, "kappa": kappa})
        with ReferenceSession(replace(model, materials={"tissue": changed}), tolerance=1e-9) as session:
            return float(session.solve().must_points.forces[-1])

    with ReferenceSession(model, tolerance=1e-9) as session:
        solved = session.solve(wrt=[("tissue", "kappa")])
    assert solved.differenced
    slope = (force(0.0505) - force(0.0495)) / 0.001
    assert solved.force_gradient["tissue", "kappa"][-1] == pytest.approx(slope, rel=1e-3)


@pytest.mark.parametrize(
    ("kind", "type_", "rule"),
    [
        ("hex8", "three-field-solid", None), ("hex8", "elastic-solid", "elastic-solid"),
        ("penta6", "elastic-solid", "elastic-solid"), ("tet10", "elastic-solid", None),
        ("hex8", 'elastic-solid" elem_type="HEX8G8', "elastic-solid"),
        ("penta6", 'elastic-solid" elem_type="PENTA6G6', "elastic-solid"),
    ],
)  # fmt: skip
def test_the_formulation_of_a_file_is_kept(tmp_path: Path, kind: str, type_: str, rule: str | None) -> None:
    path = write_feb(sheared(kind, LAWS["ogden"]), tmp_path / "model.feb")
    text = path.read_text()
    path.write_text(text.replace('mat="tissue"/>', f'mat="tissue" type="{type_}"/>'))
    model = read_feb(path)
    assert model.domains[0].rule == rule
    assert read_feb(write_feb(model, tmp_path / "again.feb")).domains[0].rule == rule


@pytest.mark.parametrize(("kind", "law"), [("tet10", "ogden_uncoupled"), ("hex8", "neo_hooke")])
def test_a_three_field_part_is_of_hexahedra_or_wedges_with_an_uncoupled_law(
    tmp_path: Path, kind: str, law: str
) -> None:
    material = LAWS["ogden"] if law == "ogden_uncoupled" else Material(law, {"mu": 0.01, "lambda": 0.02})
    path = write_feb(sheared(kind, material), tmp_path / "model.feb")
    path.write_text(path.read_text().replace('mat="tissue"/>', 'mat="tissue" type="three-field-solid"/>'))
    with pytest.raises(CaseError, match="three-field-solid"):
        read_feb(path)
