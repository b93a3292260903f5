"""Volumetric locking: constant-strain tetrahedra cannot deform at constant volume without stiffening.

At K/mu = 200 to 1300 (f_kappa 100 to 650) linear tetrahedra give forces two to six times too high, increasing
with f_kappa. This is not tested statistically: the elements are exchanged (tet4 to tet10 on the same corners)
and the prediction is compared again.
Tell-tale: the force scale grows with f_kappa; the superficial third of the speeds is 20 % low.
Source: Hughes 2000, The Finite Element Method, section 4.4; Puso & Solberg 2006, Int J Numer Meth Eng 67:841
(constant-strain tetrahedra near incompressibility).
"""

from __future__ import annotations

from limbcli.effects.effect import Effect, Parameter, Theta
from limbcli.meshing.elements import with_element
from limbcli.model import LimbModel

MENDED = Parameter("quadratic_elements", null=0.0, start=1.0, low=0.0, high=1.0, typical=1.0, prior="0 or 1")


def apply(model: LimbModel, theta: Theta) -> LimbModel:
    """Convert tet4 cells to tet10 with straight edges, together with their facets and node sets."""
    return model if theta[MENDED.name] < 0.5 else with_element(model, "tet10")


EFFECT = Effect(
    name="locking",
    sentence="the linear elements lock: the mesh, not the tissue, determines the force",
    kind="numerical",
    source="Hughes 2000, The Finite Element Method, section 4.4",
    parameters=(MENDED,),
    apply=apply,
    solves=True,
    new_mesh=True,
)
