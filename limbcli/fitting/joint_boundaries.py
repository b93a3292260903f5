"""The boundaries of the models in a joint fit, as an uncertainty of each site's force."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from limbcli.fitting.boundary_check import ChangedForces, boundary_modes
from limbcli.inference.adaptive import Intervals
from limbcli.inference.geometry_uncertainty import total_share
from limbcli.inference.joint import JointProblem, joint_fit
from limbcli.progress import SILENT, Progress


def allowing_for(
    changed: Sequence[Sequence[ChangedForces]], problem: JointProblem, found: Intervals, *,
    max_solves: int, progress: Progress = SILENT,
) -> tuple[JointProblem, Intervals]:  # fmt: skip
    """A joint fit repeated from its result, with the boundaries' part in the gain of every site.

    changed : by site, the forces with other boundaries; empty if none were solved

    A gain multiplies all forces of a site, so that what a boundary changes counts with its root mean square
    over the levels. Simulations of the first fit are not repeated.
    """
    shares = [
        total_share(list(boundary_modes(each, len(data.knots))))
        for each, data in zip(changed, problem.task.data, strict=True)
    ]
    if not any(shares):
        return problem, found
    wider = [
        replace(data, gain_deviation=float(np.hypot(data.gain_deviation, share)))
        for data, share in zip(problem.task.data, shares, strict=True)
    ]
    start = found.best[: 1 + problem.n_shape]
    return joint_fit(replace(problem.task, data=wider), [start], max_solves=max_solves, progress=progress)
