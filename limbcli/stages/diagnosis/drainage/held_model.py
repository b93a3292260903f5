"""A held indentation of biphasic tissue, as FEBio is given it: pressed in at once, and held while it drains.

Permeability times c is 1 mm^2/s, so that the simulated seconds are k c t in mm^2. The largest step grows with
the time since the ramp, a third of a decade at a time.
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

RAMP = 0.2 * float(SPREADS[0])  # mm^2
END = float(SPREADS[-1])
_PER_DECADE = 3
# mm at most: a larger part of an element inverts tet10; what fails is tried with less.
RAMP_STEPS = (0.5, 0.1)
_LEAST_STEP = 1e-2  # of the first one
LONGEST_STEP = "longest_step"
# Those of `robust_step` but for the residual's, with which holds of a limb of 6,000 nodes ran to their end.
_CONTROL = {"dtol": 0.01, "etol": 0.01}


def held_model(
    meshed: LimbModel, depth: float, *, c: float, m: float, ramp_step: float = RAMP_STEPS[0]
) -> LimbModel:
    """The site's model (as `mesh` makes it) at one depth (mm): c in MPa; f_kappa drained as the effect's.

    ramp_step : mm, the longest step while it is pressed in
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
    """What a finished simulation of `held_model` says."""
    later = simulation.times > 0
    return HeldIndentation(depth, RAMP, simulation.times[later], simulation.probe_force()[later])
