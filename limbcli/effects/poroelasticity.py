"""Fluid drains out of the squeezed tissue.

sigma = -p I + sigma_e, div(v - k grad p) = 0, over a time L^2/((lambda + 2 mu) k): the drained solid is
compressible (f_kappa 0.3 to 20), the fluid supplies incompressibility at first.
FEBio: module `biphasic`; the reference solver refuses it, so that without FEBio it is not evaluated.
Tell-tale: creep whose time grows with the square of the footprint; volume lost under the probe.
Source: Mow et al. 1980, J Biomech Eng 102:73.
"""

from __future__ import annotations

from dataclasses import replace

from limbcli.effects.base import Effect, Parameter, Theta
from limbcli.effects.tissue import TISSUE, core, ground_modulus, with_core
from limbcli.model import LimbModel, Material

DRAINED = "drained_f_kappa"
PERMEABILITY = Parameter("permeability_mm4_per_n_s", null=0.0, start=10.0, low=0.0, high=500.0, typical=50.0,
                         prior="muscle and fat: 0.01 to 230")  # fmt: skip


def apply(model: LimbModel, theta: Theta) -> LimbModel:
    k = theta[PERMEABILITY.name]
    if k == 0.0:
        return model
    kappa = theta.get(DRAINED, 2.0) * ground_modulus(model)
    softened = with_core(model, core(model.materials[TISSUE]).with_parameters(kappa=kappa))
    solid = softened.materials[TISSUE]
    fluid = {"phi0": 0.2, "fluid_density": 1e-9, "perm": k}
    wet = softened.with_material(TISSUE, Material("biphasic", fluid, (solid,)))
    steps = tuple(replace(each, analysis="transient") for each in wet.steps)
    contacts = tuple(replace(each, kind="sliding-biphasic") for each in wet.contacts)
    return replace(wet, steps=steps, contacts=contacts)


EFFECT = Effect(
    name="poroelasticity",
    sentence="fluid drains out of the squeezed tissue",
    kind="tissue",
    source="Mow et al. 1980, J Biomech Eng 102:73",
    parameters=(PERMEABILITY,),
    needs=("force", "hold"),
    apply=apply,
    grid=({DRAINED: 2.0},),
    solves=True,
    febio_only=True,
    tell_tale="slow creep, slower under a larger footprint",
)
