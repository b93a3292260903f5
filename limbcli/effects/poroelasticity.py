"""Fluid drains out of the compressed tissue.

sigma = -p I + sigma_e, div(v - k grad p) = 0, over a time L^2/((lambda + 2 mu) k): the drained solid is
compressible (f_kappa 0.3 to 20), and the fluid makes the tissue incompressible at first.
FEBio: module `biphasic`. The reference solver does not support it, so without FEBio the effect is not
evaluated. With FEBio a few held indentations determine the drainage (`drainage`), and the force follows for
any permeability and history. Skin, probe and bone are impermeable; through the cuts, beyond which the tissue
continues, fluid flows freely. Shear waves are those of the skeleton, whose shear modulus does not depend on
the fluid pressure; the slightly different deformation of drained tissue affects them only to second order and
is neglected.
Tell-tale: creep whose time grows with the square of the footprint; volume lost under the probe.
Source: Mow et al. 1980, J Biomech Eng 102:73.
"""

from __future__ import annotations

import math
from dataclasses import replace

from limbcli.effects.drainage import Drainage
from limbcli.effects.effect import Effect, Parameter, Theta
from limbcli.effects.reading import Reading
from limbcli.effects.tissue import TISSUE, core, ground_modulus, with_core
from limbcli.model import LimbModel, Material, Support

DRAINED = "drained_f_kappa"
CUT = "cut"  # the node set where the mesh ends but the tissue does not
# Permeability (mm^4/(N s)) below which the drainage in a hold of some seconds is proportional to the
# permeability, and above which it grows about as its logarithm.
BENDS = 0.2


def mm4_per_n_s(value: float, c_kpa: float) -> float:
    """Permeability; the fitted parameter is ln(1 + k / 0.2), in which drainage is about linear."""
    return BENDS * math.expm1(value)


PERMEABILITY = Parameter("log_permeability_ratio", null=0.0, start=3.9, low=0.0, high=7.8, typical=5.5,
                         prior="muscle and fat: permeability 0.01 to 230 mm^4/(N s)",
                         looked_at=1.0, reported="permeability_mm4_per_n_s",
                         turn=mm4_per_n_s)  # fmt: skip


def permeability(theta: Theta) -> float:
    """In mm^4/(N s).

    >>> round(permeability(with_permeability(50.0)), 9)
    50.0
    """
    return PERMEABILITY.quantity(theta[PERMEABILITY.name], 0.0)


def with_permeability(k: float) -> dict[str, float]:
    """The effect's parameter for a permeability in mm^4/(N s)."""
    return {PERMEABILITY.name: math.log1p(k / BENDS)}


def apply(model: LimbModel, theta: Theta) -> LimbModel:
    """Biphasic tissue for FEBio; load and time are unchanged."""
    k = permeability(theta)
    if k == 0.0:
        return model
    kappa = theta.get(DRAINED, 2.0) * ground_modulus(model)
    softened = with_core(model, core(model.materials[TISSUE]).with_parameters(kappa=kappa))
    solid = softened.materials[TISSUE]
    fluid = {"phi0": 0.2, "fluid_density": 1e-9, "perm": k}
    biphasic = softened.with_material(TISSUE, Material("biphasic", fluid, (solid,)))
    # In a hold hardly anything moves, so a residual relative to the step's first one cannot become small.
    steps = tuple(
        replace(each, analysis="transient", control={**each.control, "rtol": 0.0}) for each in biphasic.steps
    )
    if len(biphasic.mesh.node_sets.get(CUT, ())):
        biphasic = replace(biphasic, supports=(*biphasic.supports, Support(CUT, ("p",))))
    return replace(biphasic, steps=steps)


def with_drainage(drainage: Drainage) -> Effect:
    """The effect at a site whose drainage is known: it acts on the reading, without a simulation for each
    value."""

    def observe(reading: Reading, theta: Theta) -> Reading:
        rate = permeability(theta) * reading.c
        return reading if rate == 0.0 else replace(reading, draining=(*reading.draining, (drainage, rate)))

    return replace(EFFECT, observe=observe, solves=False, febio_only=False)


EFFECT = Effect(
    name="poroelasticity",
    sentence="fluid drains out of the compressed tissue",
    kind="tissue",
    source="Mow et al. 1980, J Biomech Eng 102:73",
    parameters=(PERMEABILITY,),
    needs=("force", "hold"),
    apply=apply,
    grid=({DRAINED: 2.0},),
    solves=True,
    febio_only=True,
)
