"""Muscle that contracts: an active stress along the fibres.

sigma += (T0/J) (F a0)(F a0)', T0 0 to 30 kPa (0 to 10 % of the maximal stress); along the fibre rho v^2 grows
by T0 l^2, across it initially not at all. The contraction is present from the start, or from a level onwards
(guarding, when the indentation begins to hurt). In a model file it is present from the start.
FEBio: `prescribed fiber active contraction` in a `solid mixture`.
Tell-tale: the force jumps or fluctuates within a hold, and repeats differ; rotated speeds jump more.
Source: Zajac 1989, Crit Rev Biomed Eng 17:359; Nordez & Hug 2010, J Appl Physiol 108:1389.
"""

from __future__ import annotations

from limbcli.effects.effect import Effect, Parameter, Theta, times_c
from limbcli.effects.tissue import fibre_direction, ground_modulus, with_part
from limbcli.model import LimbModel, Material, Value

TENSION = Parameter("active_stress_per_c", null=0.0, start=0.3, low=0.0, high=4.0, typical=0.6,
                    prior="0 to 30 kPa; guarding, a few kPa", reported="t0_kpa", turn=times_c)  # fmt: skip


ONSET = "tensed_after_share_of_levels"


def apply(model: LimbModel, theta: Theta) -> LimbModel:
    tension = theta[TENSION.name]
    if tension == 0.0:
        return model
    active: dict[str, Value] = {"T0": tension * ground_modulus(model), "fiber": fibre_direction(model)}
    return with_part(model, Material("active_contraction", active))


EFFECT = Effect(
    name="contraction",
    sentence="the muscle was contracted",
    kind="tissue",
    source="Zajac 1989, Crit Rev Biomed Eng 17:359",
    parameters=(TENSION,),
    apply=apply,
    grid=tuple({ONSET: k / 16} for k in (0, *range(4, 13))),  # every level, where there are up to 16
    onset=ONSET,
    solves=True,
)
