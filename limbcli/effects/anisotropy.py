"""Muscle fibres: stiffer along the fibres than across them, in shear and in tension.

Psi += Psi_f(I4) with Cauchy stress (1/J) [2 ksi (I4 - 1) N + mu_f sym(N (b - 1))], N = (F a0)(F a0)', where
I4 > 1. At small strain mu_along = mu_across + mu_f/2, and the fibres add 4 ksi + 2 mu_f to the stiffness
along them. The transverse image measures the speed across the fibres, while a probe pressing across the limb
deforms the tissue along the fibres, so the force is larger than expected from c = 2 mu_SWE.
a0: the fibre direction given in the case, else the limb's long axis.
FEBio: `solid mixture` with `fiber-exp-pow` (alpha 0, beta 2).
Tell-tale: with the probe turned by 90 degrees speeds rise and force falls.
Source: Criscione et al. 2001, J Mech Phys Solids 49:871 (shear moduli of fibred tissue); Gennisson et al.
2010, Ultrasound Med Biol 36:789 (muscle: 4 to 5 times as fast along fibres).
"""

from __future__ import annotations

from limbcli.effects.effect import Effect, Parameter, Theta, times_c
from limbcli.effects.tissue import fibre_direction, ground_modulus, with_part
from limbcli.model import LimbModel, Material, Value

EXPONENT = "fibre_exponent"
SHEAR = Parameter("fibre_shear_per_c", null=0.0, start=0.5, low=0.0, high=5.0, typical=1.0,
                  prior="muscle: mu along / across 1.3 to 3, so mu_f/c 0.3 to 2",
                  reported="mu_f_kpa", turn=times_c)  # fmt: skip
TENSION = Parameter("fibre_tension_per_c", null=0.0, start=0.3, low=0.0, high=5.0, typical=0.5,
                    prior="passive muscle: tensile anisotropy 2 to 5",
                    reported="ksi_kpa", turn=times_c)  # fmt: skip


def apply(model: LimbModel, theta: Theta) -> LimbModel:
    """Add fibres in parallel with the tissue's law; their stiffnesses are given relative to c, so that they
    scale with it."""
    shear, tension = theta[SHEAR.name], theta[TENSION.name]
    if shear == 0.0 and tension == 0.0:
        return model
    c = ground_modulus(model)
    fibre: dict[str, Value] = {
        "ksi": tension * c, "alpha": theta.get(EXPONENT, 0.0), "beta": 2.0, "mu": shear * c, "lam0": 1.0,
        "fiber": fibre_direction(model),
    }  # fmt: skip
    return with_part(model, Material("fiber_exp_pow", fibre))


EFFECT = Effect(
    name="anisotropy",
    sentence="muscle fibres make the tissue stiffer in their direction",
    kind="tissue",
    source="Gennisson et al. 2010, Ultrasound Med Biol 36:789",
    parameters=(SHEAR, TENSION),
    apply=apply,
    grid=({EXPONENT: 0.0}, {EXPONENT: 3.0}),
    solves=True,
)
