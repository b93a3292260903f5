"""FEBio model of a held indentation of biphasic tissue: a fast ramp, and a hold while the tissue drains.

Permeability times c is 1 mm^2/s, so that the simulated time in s equals k c t in mm^2. The largest time step
grows with the time since the ramp, every third of a decade.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from limbcli.effects import poroelasticity
from limbcli.effects.drainage import SPREADS, HeldIndentation
from limbcli.feb.settings import USUAL_PENALTY, schedule
from limbcli.model import Curve, LimbModel
from limbcli.solvers.base import Simulation
from limbcli.stages.site_model.indentation_model import (
    TRAVEL,
    indentation_model,
    starting_depth,
    with_penalty,
)

RAMP = 0.2 * float(SPREADS[0])  # mm^2, duration of the ramp as k c t
END = float(SPREADS[-1])  # mm^2, end of the hold as k c t
_PER_DECADE = 3  # intervals of the largest time step per decade
# mm, largest indentation per step of the ramp: a larger fraction of an element inverts tet10. Failed
# simulations are repeated with the smaller step.
RAMP_STEPS = (0.5, 0.1)
_LEAST_STEP = 1e-2  # smallest time step, as a fraction of the first
LONGEST_STEP = "longest_step"
# Tolerances of `robust_step` except that of the residual; with these, holds of a limb of 6,000 nodes
# completed.
_CONTROL = {"dtol": 0.01, "etol": 0.01}


def held_model(
    meshed: LimbModel, depth: float, *, c: float, m: float, ramp_step: float = RAMP_STEPS[0]
) -> LimbModel:
    """Held model of a site at one depth (mm); c in MPa; drained f_kappa as in the effect.

    meshed : the site's model as `mesh` makes it; ramp_step : mm, largest step of the ramp
    """
    start = starting_depth(meshed, depth)
    model = indentation_model(meshed, schedule([depth], start=start), c=c, f_kappa=100.0, m=m)
    theta = {**poroelasticity.with_permeability(1.0 / c), **poroelasticity.EFFECT.grid[0]}
    biphasic = poroelasticity.apply(with_penalty(model, USUAL_PENALTY), theta)
    first = RAMP / np.ceil((depth - start) / ramp_step)
    edges = np.geomspace(RAMP, END, round(_PER_DECADE * np.log10(END / RAMP)) + 1)
    times = [0.0, *(float(f"{each:.4g}") for each in edges)]
    largest = [first, *(np.diff(edges).tolist()), float(edges[-1] - edges[-2])]
    n_steps = int(np.ceil(times[-1] / first))
    step = replace(
        biphasic.steps[0], n_steps=n_steps, step_size=times[-1] / n_steps, dt_min=_LEAST_STEP * first,
        must_points=(), dt_max_curve=LONGEST_STEP, control={**biphasic.steps[0].control, **_CONTROL},
    )  # fmt: skip
    travel = depth - start
    curves = {
        TRAVEL: Curve(((0.0, 0.0), (times[1], travel), (times[-1], travel))),
        LONGEST_STEP: Curve(tuple(zip(times, largest, strict=True)), interpolate="step"),
    }
    return replace(biphasic, curves=curves, steps=(step,), records=biphasic.records[:1])


def hold_of(simulation: Simulation, depth: float) -> HeldIndentation:
    """Force over time of a finished simulation of `held_model`."""
    later = simulation.times > 0
    return HeldIndentation(depth, RAMP, simulation.times[later], simulation.probe_force()[later])
