"""Candidate missing effects, one per file; the list in this file is their index.

An effect consists of a sentence that states the physics, its parameters, and a pure change of the model
(`apply`) or of the reading (`observe`). Numerical effects come first, because what the mesh explains needs no
new tissue. A further effect is one file that defines `EFFECT`; it is either listed here or given with
`limbcli diagnose --effect-file`.
"""

from __future__ import annotations

from limbcli.effects import (
    adipose_layer,
    anisotropy,
    contact,
    contraction,
    crop,
    depth_gain,
    depth_zero,
    force_gain,
    force_zero,
    friction,
    inclusion,
    locking,
    nonlinearity,
    poroelasticity,
    preload,
    skin_layer,
    support_motion,
    swe_depth_bias,
    swe_guided_wave,
    swe_time_scale,
    thickness,
    tilt,
    viscoelasticity,
)
from limbcli.effects.effect import Effect, Parameter
from limbcli.errors import CaseError
from limbcli.errors.problems import suggestion

EFFECTS: tuple[Effect, ...] = tuple(each.EFFECT for each in (
    locking, crop, contact, force_zero, force_gain, depth_zero, depth_gain, tilt, support_motion, thickness,
    anisotropy, skin_layer, adipose_layer, inclusion, viscoelasticity, poroelasticity, nonlinearity, preload,
    contraction, friction, swe_time_scale, swe_guided_wave, swe_depth_bias,
))  # fmt: skip

__all__ = ["EFFECTS", "Effect", "Parameter", "effect"]


def effect(name: str, effects: tuple[Effect, ...] = EFFECTS, *, option: str = "--effects") -> Effect:
    """The effect with the given name.

    option : the command-line option that requested it, for the error

    Raises CaseError if there is none of that name.

    >>> effect("skin-layer").kind
    'tissue'
    """
    for each in effects:
        if each.name == name:
            return each
    raise CaseError(
        f"there is no effect {name!r}",
        where=option,
        fix=suggestion(name, [each.name for each in effects]),
    )
