"""Settings with which FEBio is known to converge on an indentation, and the reasons for them.

They are derived from models of a limb and of blocks under a probe that FEBio 4.11 completed: BFGS with the
symmetric matrix (the cheapest option; full Newton with frictionless sliding-elastic converges only linearly),
a penalty of 20 times the tissue's own stiffness (auto_penalty), a probe that starts slightly inside the
tissue, so that the first iteration has a contact force as reference for convergence, a first step of 0.2 mm,
and steps of at most 1 mm (a step of a large part of an element inverts tet10).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from limbcli.errors import CaseError
from limbcli.model import Curve, Step
from limbcli.model.bodies import Contact

SECONDS_PER_MM = 0.1
FIRST_STEP_S = 0.02
LARGEST_STEP_S = 0.1
SMALLEST_STEP_S = 0.001
START_DEPTHS = (0.05, 0.1, 0.15, 0.2)
LEAST_START = 0.02  # no level above this depth (mm) is simulated: the probe already starts there
_START_SHARE = 0.5
_LEAST_APART = 0.02
_TIME_DIGITS = 3

# Tolerances: with them the force of each level is within 0.1 % of a solve to 1e-8 (cost of each:
# templates/feb/README.md). For tet4 they are FEBio's defaults. With dtol 0.01, tet10 forces are up to 0.3 %
# off, and in one case 1.2 % at a first level.
TOLERANCES: dict[str, dict[str, float]] = {
    "tet10": {"dtol": 0.001, "etol": 0.01, "rtol": 1e-5},
    "tet4": {"dtol": 0.001, "etol": 0.01, "rtol": 0.0},
}


@dataclass(frozen=True)
class Schedule:
    """Times at which the probe reaches given depths.

    start : depth of the probe face at time 0 (mm)
    times, depths : s (short decimals) and mm, of equal length, increasing
    """

    start: float
    times: tuple[float, ...]
    depths: tuple[float, ...]

    def curve(self) -> Curve:
        """Load curve of the probe's travel from its start (mm, positive inwards) over time."""
        travel = [depth - self.start for depth in self.depths]
        return Curve(((0.0, 0.0), *zip(self.times, travel, strict=True)))

    @property
    def n_steps(self) -> int:
        return round(self.times[-1] / FIRST_STEP_S)


def schedule(depths: Sequence[float], *, start: float | None = None) -> Schedule:
    """Schedule of about 0.1 s per millimetre, with each level at a time of at most three decimals.

    Rounded times are harmless as points of a load curve, but a must-point slightly before the end of the load
    leaves a step too small to converge. Therefore the last time is a multiple of the first step that is exact
    in binary arithmetic.

    depths : mm, increasing, all above `LEAST_START`
    start : depth of the probe at time 0 (mm); None: 0.05, less if the first level is shallow

    Raises CaseError if the depths do not increase, or the first is too small.

    >>> schedule([1.0, 2.5, 8.0])
    Schedule(start=0.05, times=(0.1, 0.25, 0.8), depths=(1.0, 2.5, 8.0))
    >>> schedule([0.06, 0.061]).times
    (0.006, 0.02)
    """
    growing = all(later > earlier for earlier, later in itertools.pairwise(depths))
    if not depths or depths[0] <= LEAST_START or not growing:
        raise CaseError(
            f"the depths {list(depths)} mm do not increase from {LEAST_START:g} mm on",
            where="load schedule",
            fix="give increasing depths, each once",
        )
    times: list[float] = []
    for depth in depths:
        time = round(depth * SECONDS_PER_MM, _TIME_DIGITS)
        earliest = times[-1] + SMALLEST_STEP_S if times else SMALLEST_STEP_S
        times.append(round(max(time, earliest), _TIME_DIGITS))
    times[-1] = whole_steps(times[-1]) * FIRST_STEP_S
    if start is None:
        start = min(START_DEPTHS[0], max(LEAST_START, _START_SHARE * depths[0]))
    return Schedule(start=start, times=tuple(times), depths=tuple(float(each) for each in depths))


def whole_steps(time: float) -> int:
    """Number of first steps until a time (s), or one that ends slightly later if binary arithmetic would miss
    that time.

    >>> whole_steps(0.25)
    13
    """
    n_steps = math.ceil(time / FIRST_STEP_S - 1e-9)
    while n_steps * FIRST_STEP_S != round(n_steps * FIRST_STEP_S, _TIME_DIGITS):
        n_steps += 1
    return n_steps


def apart(depths: Sequence[float]) -> list[float]:
    """Depths at least 0.02 mm apart, always including the deepest.

    A step of a few micrometres has hardly any load as a reference for its convergence.

    >>> apart([0.5, 1.0, 1.005, 4.0, 4.001])
    [0.5, 1.0, 4.001]
    """
    kept: list[float] = []
    for depth in depths:
        if not kept or depth - kept[-1] >= _LEAST_APART:
            kept.append(float(depth))
    if kept and kept[-1] != depths[-1]:
        kept[-1] = float(depths[-1])
    return kept


def robust_step(plan: Schedule, element: str) -> Step:
    """One static step through all levels."""
    control: dict[str, Any] = {
        "symmetric_stiffness": "symmetric",
        "max_refs": 25,
        **TOLERANCES.get(element, TOLERANCES["tet10"]),
        "qn_method": "BFGS",
        "max_ups": 10,
    }
    return Step(
        n_steps=plan.n_steps, step_size=FIRST_STEP_S, analysis="static", dt_min=SMALLEST_STEP_S,
        dt_max=LARGEST_STEP_S, must_points=plan.times, max_retries=8, opt_iterations=25, control=control,
    )  # fmt: skip


USUAL_PENALTY = 20.0  # multiple of the tissue's stiffness with which FEBio converges for tet4 and tet10


def robust_contact(contact: Contact) -> Contact:
    """The same pair of surfaces, frictionless, with settings that converge for tet4 and tet10.

    At penalty 20 the force of tet10 is 2 to 3 % below that of augmented Lagrangian, that of tet4 4 to 6 %; at
    200 tet10 did not converge.
    """
    return replace(
        contact,
        kind="sliding-elastic",
        penalty=USUAL_PENALTY,
        auto_penalty=True,
        update_penalty=False,
        augmented=False,
        tolerance=0.05,
        gap_tolerance=0.0,
        search_radius=5.0,
        friction=0.0,
        symmetric=True,
        two_pass=False,
        knmult=0.0,
        search_tolerance=0.01,
        more={"seg_up": "0", "tension": "0", "minaug": "0", "maxaug": "20"},
    )
