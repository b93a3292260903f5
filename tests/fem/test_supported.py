"""What the solver takes; and whether its kernels are on disk already."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from small_models import punch

from limbcli.errors import SolveError
from limbcli.fem.analysis import Analysis
from limbcli.fem.equilibrium.settings import Settings
from limbcli.fem.supported import check_supported, on_disk, refuse_without_stiffness
from limbcli.model import Curved, ElementMap, Step
from limbcli.model.bodies import Drive


def test_kernels_that_were_compiled_are_found_on_disk():
    """Their index files carry the name of the module they are in, which a rename changes."""
    Analysis(punch(levels=1, depth=0.2), Settings(threads=1)).run()
    assert on_disk()


def test_a_relative_force_is_taken_in_the_first_step_alone():
    """There it is from no force; later from what the body is held with."""
    load = Drive("probe", "z", "force", -0.01, "ramp", relative=True)
    model = replace(punch(), drives=())
    check_supported(replace(model, steps=(Step(drives=(load,)), Step())))
    with pytest.raises(SolveError, match="relative force"):
        check_supported(replace(model, steps=(Step(), Step(drives=(load,)))))


@pytest.mark.parametrize(("name", "value"), [("penalty", 0.0), ("penalty", -20.0), ("friction", -1.0)])
def test_a_contact_that_cannot_press_is_refused(name: str, value: float):
    model = punch()
    contact = replace(model.contacts[0], **{name: value})
    with pytest.raises(SolveError, match=f"{value:g} is"):
        check_supported(replace(model, contacts=(contact,)))


def test_the_arc_length_method_is_refused():
    check_supported(replace(punch(), steps=(Step(control={"arc_length": 0}),)))
    with pytest.raises(SolveError, match="arc-length"):
        check_supported(replace(punch(), steps=(Step(control={"arc_length": 1}),)))


@pytest.mark.parametrize("c", [-0.01, 0.0])
@pytest.mark.parametrize("as_map", [False, True])
def test_tissue_that_does_not_resist_shear_is_refused(c: float, as_map: bool):
    """With it the probe meets no force at all."""
    model = punch()
    (block,) = model.mesh.solid_blocks
    law = model.materials["tissue"]
    terms = {key: c if key in ("c1", "c2") else value for key, value in law.parameters.items()}
    if as_map:
        terms["c1"] = ElementMap("c", block.name, np.r_[np.full(len(block.cells) - 1, 0.01), 2 * c])
    refuse_without_stiffness(model)
    with pytest.raises(SolveError, match="does not resist deformation"):
        refuse_without_stiffness(replace(model, materials={"tissue": replace(law, parameters=terms)}))
    refuse_without_stiffness(
        replace(model, materials={"tissue": replace(law, parameters={**terms, "c1": Curved(c, "ramp")})})
    )


def test_tissue_of_a_modulus_that_is_no_number_is_refused():
    model = punch()
    law = model.materials["tissue"].with_parameters(c1=float("nan"))
    with pytest.raises(SolveError, match="does not resist deformation"):
        refuse_without_stiffness(model.with_material("tissue", law))


def test_an_exponent_that_is_0_in_one_cell_is_refused():
    model = punch()
    (block,) = model.mesh.solid_blocks
    m = ElementMap("m", block.name, np.r_[np.full(len(block.cells) - 1, 2.0), 0.0])
    law = model.materials["tissue"].with_parameters(m1=m)
    with pytest.raises(SolveError, match="exponent m1 is 0"):
        check_supported(replace(model, materials={"tissue": law}))
