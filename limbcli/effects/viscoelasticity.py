"""Stress relaxation: the stress depends on the loading history.

S(t) = int G(t - s) dS_e/ds ds, G = 1 + sum g_i exp(-t/tau_i), with c the equilibrium stiffness. Under a
prescribed depth and one relaxation function for the whole stress, the force is the same convolution of the
elastic force (exactly at small strain, within a few per cent at large), which is how it is predicted here;
shear waves see 1 + sum g_i. Tissue relaxes over a continuous range of times. Where holds were recorded, two
terms about a decade apart represent it; levels alone do not tell the two apart, and have one.
FEBio: `viscoelastic` around the tissue's law.
Tell-tale: decay at constant depth, or creep at constant force, in every hold; hysteresis.
Source: Fung 1993, Biomechanics, section 7.6; Zheng & Mak 1999, J Biomech Eng 121:330 (limb tissue).
"""

from __future__ import annotations

from dataclasses import replace

from limbcli.effects.effect import Effect, Parameter, Theta
from limbcli.effects.reading import Reading
from limbcli.effects.tissue import TISSUE, WRAPPERS, within
from limbcli.model import LimbModel, Material

TAU = "relaxation_time_s"
# Time constant of the second share beside each of the first (s): about a decade away, and of those times of
# which holds of some tens of seconds show the decay.
_SECOND_TIME = {1.0: 10.0, 10.0: 60.0, 60.0: 10.0}
SHARE = Parameter("relaxing_share", null=0.0, start=0.2, low=0.0, high=3.0, typical=0.3,
                  prior="limb tissue, quasi-linear: 0.03 to 0.3", reported="g1")  # fmt: skip
SECOND = Parameter("second_relaxing_share", null=0.0, start=0.1, low=0.0, high=3.0, typical=0.1,
                   prior="as the first share", needs=("hold",), reported="g2")  # fmt: skip


def terms(theta: Theta) -> tuple[tuple[float, float], ...]:
    """(share, time constant in s) of the terms that are present.

    >>> terms({"relaxing_share": 0.3, "second_relaxing_share": 0.1, "relaxation_time_s": 1.0})
    ((0.3, 1.0), (0.1, 10.0))
    """
    tau = theta.get(TAU, 10.0)
    both = ((theta[SHARE.name], tau), (theta.get(SECOND.name, 0.0), _SECOND_TIME.get(tau, 10.0 * tau)))
    return tuple((share, time) for share, time in both if share != 0.0)


def apply(model: LimbModel, theta: Theta) -> LimbModel:
    """Wrap the tissue's law for FEBio; load and time are unchanged."""
    found = terms(theta)
    if not found:
        return model
    prony = {"g0": 1.0}
    for k, (share, tau) in enumerate(found, 1):
        prony |= {f"g{k}": share, f"t{k}": tau}

    def relaxing(solid: Material) -> Material:
        return Material("viscoelastic", prony, (solid,), solid.density)

    outer = WRAPPERS[: WRAPPERS.index("viscoelastic")]
    return model.with_material(TISSUE, within(model.materials[TISSUE], outer, relaxing))


def observe(reading: Reading, theta: Theta) -> Reading:
    return replace(reading, prony=(*reading.prony, *terms(theta)))


EFFECT = Effect(
    name="viscoelasticity",
    sentence="stress relaxes while a level is held",
    kind="tissue",
    source="Fung 1993, Biomechanics, section 7.6",
    parameters=(SHARE, SECOND),
    apply=apply,
    observe=observe,
    grid=tuple({TAU: time} for time in _SECOND_TIME),
)
