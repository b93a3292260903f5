"""Depth and force of a rigid body in a model that is not limbcli's own.

In limbcli's models of a site z = 0 is the height of the probe face at first touch. Elsewhere a body may lie
and move anywhere: its depth is its travel since first contact, in the direction in which it moves.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from limbcli.model import Array
from limbcli.solvers.solver import Table

AXES = "xyz"
_NO_FORCE = 1e-9  # force that is round-off, relative to the largest
_LEAST_FORCE_N = 1e-12


@dataclass(frozen=True, eq=False)
class Travel:
    """depth (n_times,) mm, force (n_times,) N, compression positive; note : what they are relative to."""

    depth: Array
    force: Array
    note: str
    touches: bool


def travel(body: str, table: Table) -> Travel:
    """Travel since first contact along the axis of which the table holds place and force.

    The place of first contact is where the line through the first two states with force meets force 0, but
    not outside the step in which the force begins.

    table : must have the fields z and Fz
    """
    axes = [axis for axis in AXES if {axis, f"F{axis}"} <= set(table.fields)]
    moved = {axis: table.column(axis)[:, 0] - table.column(axis)[0, 0] for axis in axes}
    axis = max(axes, key=lambda each: (float(np.abs(moved[each]).max()), each))
    path = moved[axis]
    sign = float(np.sign(path[np.argmax(np.abs(path))])) or -1.0
    depth, force = sign * path, sign * table.column(f"F{axis}")[:, 0]
    acting = np.abs(force) > max(_NO_FORCE * float(np.abs(force).max()), _LEAST_FORCE_N)
    way = f"{'+' if sign > 0 else '-'}{axis}"
    if not acting.any():
        note = f"no force acts on {body} in any step: depth_mm is its travel along {way} from the start"
        return Travel(depth, force, note, touches=False)
    start = _first_contact(depth, force, int(np.argmax(acting)))
    note = f"depth_mm is the travel of {body} along {way} since first contact, {start:.3g} mm from its start"
    return Travel(depth - start, force, note, touches=True)


def _first_contact(depth: Array, force: Array, first: int) -> float:
    """Depth (mm) at which the force begins; `first` is the first state that has one."""
    if first == 0:
        return float(depth[0])
    before, now = float(depth[first - 1]), float(depth[first])
    guess = before
    if first + 1 < len(depth) and force[first + 1] != force[first]:
        slope = (depth[first + 1] - now) / (force[first + 1] - force[first])
        guess = now - float(force[first] * slope)
    return float(np.clip(guess, min(before, now), max(before, now)))
