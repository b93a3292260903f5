"""Explain what changed between two loadings: the tissue, the load cell, or the support of the limb.

At equal force the depth of the later loading differs by
  a (constant)              depth that was not recovered, or a shift of the depth's zero
  b times the depth         tissue that has become softer or stiffer: preconditioning
  f times d depth/d force   an offset of the force: drift of the load cell
Each explanation is fitted alone by generalised least squares; they are compared by their residuals (BIC).
Depth is the loss of skin-bone distance, so a rigid motion of the limb does not affect it; such a motion is
seen if the probe's travel was measured too.

Source: Schwarz 1978, Ann Stat 6:461 (BIC).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from limbcli.measurement.levels import Levels
from limbcli.measurement.repeated_loading import LEVEL, CycleStudy, Difference
from limbcli.model import Array
from limbcli.numbers.significant_digits import short

TOLD_APART = 6.0  # difference of BIC beyond which the second best explanation is excluded (strong evidence)


@dataclass(frozen=True)
class CycleChange:
    """One explanation: its size and standard deviation, the residual chi-square, whether noise explains it.

    name : "residual depth" (mm), "compliance" (fraction) or "force offset" (N)
    """

    name: str
    size: float
    deviation: float
    left: float
    explains: bool


def changes(difference: Difference) -> tuple[CycleChange, ...]:
    """Every explanation, the best first. Empty with fewer than three common levels."""
    n = len(difference.depth)
    if n < 3:
        return ()
    columns = {
        "residual depth": np.ones(n),
        "compliance": difference.earlier_depth,
        "force offset": difference.slope,
    }
    found = [_fitted(name, column, difference) for name, column in columns.items() if np.any(column)]
    return tuple(sorted(found, key=lambda each: each.left))


def _fitted(name: str, column: Array, difference: Difference) -> CycleChange:
    from scipy.special import chdtrc

    weighted = np.linalg.solve(difference.covariance, column)
    information = float(column @ weighted)
    size = float(weighted @ difference.depth) / information
    rest = difference.depth - size * column
    left = float(rest @ np.linalg.solve(difference.covariance, rest))
    fits = bool(chdtrc(len(rest) - 1, left) >= LEVEL)
    return CycleChange(name, size, information**-0.5, left, fits)


def change_text(difference: Difference) -> str:
    """One sentence: the likely cause of the difference, or that it is undetermined."""
    pair = f"from cycle {difference.earlier} to {difference.later}"
    if difference.is_noise:
        return f"{pair} nothing changed beyond noise"
    found = changes(difference)
    able = [each for each in found if each.explains and each.left - found[0].left < TOLD_APART]
    if not able:
        return f"{pair} the curve changed in a way that no single cause explains"
    words = [_in_words(each) for each in able]
    if len(words) == 1:
        return f"{pair} {words[0]}"
    return f"{pair} either {', or '.join(words)}: these levels cannot distinguish them"


# by explanation: the unit and its factor, what a positive and a negative size mean, and the sentence
_WORDS = {
    "residual depth": (
        "mm", 1, "deeper", "less deep",
        "all depths are {size} {way}: deformation that did not recover, or a shift of the depth's zero",
    ),
    "compliance": (
        "%", 100, "softer", "stiffer", "the tissue became {way} by {size} of the depth: preconditioning",
    ),
    "force offset": (
        "N", 1, "less", "more", "the load cell reads {size} {way} at the same deformation: drift of its zero",
    ),
}  # fmt: skip


def _in_words(change: CycleChange) -> str:
    unit, factor, more, less, text = _WORDS[change.name]
    size = f"{short(factor * abs(change.size), 2)} {unit} (deviation {short(factor * change.deviation, 1)})"
    return text.format(size=size, way=more if change.size > 0 else less)


def support_text(levels: Levels, study: CycleStudy, *, travel_deviation: float) -> str | None:
    """Whether the limb moved as a whole between the loadings; None if the probe's travel was not measured.

    Travel minus depth is the displacement of the bone. Its mean is compared at those levels of the first
    loading whose force the last one also reaches.
    """
    whole = [*(each.earlier for each in study.differences), *(each.later for each in study.differences[-1:])]
    given = levels.probe_travel - levels.depth
    ends = []
    for cycle in whole[:1] + whole[-1:]:
        rows = np.flatnonzero((levels.cycle == cycle) & levels.loading & np.isfinite(given))
        if len(rows):
            ends.append((cycle, levels.force[rows], given[rows]))
    if len(ends) < 2 or ends[0][0] == ends[1][0]:
        return None
    (first, force, before), (last, other, after) = ends
    order = np.argsort(other, kind="stable")
    common = (force >= other.min()) & (force <= other.max())
    if not common.any():
        return None
    moved = np.interp(force[common], other[order], after[order]) - before[common]
    size, deviation = float(np.mean(moved)), 2.0 * travel_deviation / np.sqrt(common.sum())
    if abs(size) <= 3.0 * deviation:
        return f"travel minus depth is the same in cycles {first} and {last}: the support did not move"
    return (
        f"from cycle {first} to {last} the probe's travel grew by {short(abs(size), 2)} mm "
        f"{'more' if size > 0 else 'less'} than the depth: the limb or its support moved"
    )
