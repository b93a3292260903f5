"""Repeated loading: energy lost in each cycle, and the cycle from which the tissue response repeats.

Soft tissue under repeated loading follows a new curve each time, until its curves repeat ("preconditioning").
The area of the loop between loading and unloading is the energy lost. Curves are compared by the depth at
equal force, because force is what is controlled in a hold, with the stated noise of both readings propagated
through the interpolation.

Source: Fung 1993, Biomechanics: Mechanical Properties of Living Tissues, 2nd ed., section 7.5.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from limbcli.measurement.levels import FEWEST_LOADING, TOUCH_FORCE, Levels
from limbcli.model import Array, IntArray

LEVEL = 0.01  # significance level of the test that two loadings follow the same curve
_FEWEST_COMMON = 2  # smallest number of forces that both loadings must reach
_SAME_FORCE = 5.0  # standard deviations of the force by which readings of one level may differ


@dataclass(frozen=True, eq=False)
class Energy:
    """Energy of one cycle, N mm (mJ): work of loading, loss in unloading, and standard deviation of the loss.

    closed : whether unloading was measured down to first touch; otherwise the loss is that above its last
        level
    """

    work: float
    lost: float
    lost_deviation: float
    closed: bool

    @property
    def share(self) -> float:
        """Loss as a fraction of the work of loading."""
        return self.lost / self.work


@dataclass(frozen=True, eq=False, kw_only=True)
class Difference:
    """Difference of a later loading from an earlier one, at the forces of the earlier one that both reach.

    force (n,) N; depth (n,) mm, later minus earlier, in the file's depths
    covariance (n, n) mm^2, from the stated noise; slope (n,) mm/N, of the earlier curve
    earlier_depth (n,) mm, from the first level of that loading
    """

    earlier: int
    later: int
    force: Array
    depth: Array
    covariance: Array
    slope: Array
    earlier_depth: Array

    @property
    def chi_square(self) -> float:
        return float(self.depth @ np.linalg.solve(self.covariance, self.depth))

    @property
    def p_value(self) -> float:
        """Probability of at least this difference from noise alone."""
        from scipy.special import chdtrc  # SciPy takes longer to import than a case to check

        return float(chdtrc(len(self.depth), self.chi_square))

    @property
    def is_noise(self) -> bool:
        return self.p_value >= LEVEL

    @property
    def largest(self) -> int:
        """Index of the largest difference relative to its standard deviation."""
        return int(np.argmax(np.abs(self.depth) / np.sqrt(np.diag(self.covariance))))


@dataclass(frozen=True, eq=False)
class CycleStudy:
    """All cycles of one record.

    energy : by cycle, of those with unloading
    differences : of each complete loading from the last complete one
    repeats_from : the first cycle from which all loadings equal the last one within noise; None: the last
        differs from the one before it, or it is the only one
    """

    cycles: tuple[int, ...]
    energy: dict[int, Energy]
    differences: tuple[Difference, ...]
    repeats_from: int | None

    def contradicting(self, cycle: int) -> tuple[Difference, ...]:
        """Difference of the last loading from this one, if noise does not explain it."""
        return tuple(each for each in self.differences if each.earlier == cycle and not each.is_noise)


def study_cycles(levels: Levels, *, force_deviation: float, depth_deviation: float) -> CycleStudy:
    """Energy lost in each cycle, and the cycle from which the loadings follow the same curve.

    levels : of all cycles (`Levels.of_cycle` was not called)
    force_deviation, depth_deviation : N, mm, standard deviation of a reading; if both are 0, a cycle repeats
        another only if it is identical
    """
    noise = (force_deviation, depth_deviation)
    energy = {}
    for cycle in levels.cycles:
        found = cycle_energy(levels, cycle, *noise)
        if found is not None:
            energy[cycle] = found
    whole = [cycle for cycle in levels.cycles if levels.n_loading(cycle) >= FEWEST_LOADING]
    pairs = [compare(levels, each, whole[-1], *noise) for each in whole[:-1]]
    differences = tuple(each for each in pairs if each is not None)
    repeats = None
    for each in reversed(differences):
        if not each.is_noise:
            break
        repeats = each.earlier
    return CycleStudy(levels.cycles, energy, differences, repeats)


def cycle_energy(levels: Levels, cycle: int, force_deviation: float, depth_deviation: float) -> Energy | None:
    """Work of loading and loss of one cycle, by linear interpolation between levels; None without unloading.

    The loop is closed by the first touch of the next cycle if that follows; the standard deviation is that of
    all readings, propagated through numerical derivatives.
    """
    from scipy.optimize import approx_fprime

    up = np.flatnonzero((levels.cycle == cycle) & levels.loading)
    down = np.flatnonzero((levels.cycle == cycle) & ~levels.loading)
    if len(up) < 2 or not len(down):
        return None
    after = down[-1] + 1
    if after < len(levels) and levels.force[after] < levels.force[down[-1]]:
        down = np.r_[down, after]
    rows = np.r_[up, down]
    n_up, n = len(up), len(rows)
    readings = np.r_[levels.force[rows], levels.depth[rows]]
    closed = bool(levels.force[down].min() <= TOUCH_FORCE)

    def work_and_loss(values: Array) -> Array:
        """(2,) N mm: area below the loading curve, and between loading and unloading (from the top back).

        If not closed, both are taken from the depth of the last unloading level upwards.
        """
        force, depth = values[:n], values[n:]
        up_force, up_depth = force[:n_up], depth[:n_up]
        down_force, down_depth = force[n_up - 1 :][::-1], depth[n_up - 1 :][::-1]
        if not closed:
            start = down_depth[0]
            beyond = up_depth > start
            up_force = np.r_[np.interp(start, up_depth, up_force), up_force[beyond]]
            up_depth = np.r_[start, up_depth[beyond]]
        work = np.trapezoid(up_force, up_depth)
        return np.array([work, work - np.trapezoid(down_force, down_depth)])

    work, lost = work_and_loss(readings)
    if not work > 0:
        return None
    rates = approx_fprime(readings, work_and_loss, 1e-6)[1]
    deviations = np.repeat([force_deviation, depth_deviation], n)
    return Energy(float(work), float(lost), float(np.linalg.norm(rates * deviations)), closed)


def compare(
    levels: Levels, earlier: int, later: int, force_deviation: float, depth_deviation: float
) -> Difference | None:
    """Depths of two loadings at the forces of the earlier one; None with fewer than two common forces."""
    first = _loading(levels, earlier)
    last = _loading(levels, later)
    order = np.argsort(levels.force[last], kind="stable")
    knots = levels.force[last][order]
    room = _SAME_FORCE * force_deviation
    inside = (levels.force[first] >= knots[0] - room) & (levels.force[first] <= knots[-1] + room)
    at = first[inside]
    if len(at) < _FEWEST_COMMON or not np.ptp(knots) > 0:
        return None
    force, depth = levels.force[at], levels.depth[at]
    weights = _linear_weights(knots, force)[:, np.argsort(order, kind="stable")]
    gap = weights @ levels.depth[last] - depth
    own_slope = _slopes(levels.force[first], levels.depth[first])[inside]
    knot_slope = _slopes(knots, levels.depth[last][order])[np.argsort(order, kind="stable")]
    of_first = depth_deviation**2 + (own_slope * force_deviation) ** 2
    of_last = depth_deviation**2 + (knot_slope * force_deviation) ** 2
    covariance = np.diag(of_first) + weights @ np.diag(of_last) @ weights.T
    covariance += 1e-12 * np.eye(len(at))  # mm^2: keeps the matrix invertible without noise
    return Difference(
        earlier=earlier, later=later, force=force, depth=gap, covariance=covariance, slope=own_slope,
        earlier_depth=depth - levels.depth[first[0]],
    )  # fmt: skip


def _loading(levels: Levels, cycle: int) -> IntArray:
    return np.flatnonzero((levels.cycle == cycle) & levels.loading)


def _linear_weights(knots: Array, at: Array) -> Array:
    """Weights (n_at, n_knots) of linear interpolation and extrapolation at `at` from values at the knots.

    >>> _linear_weights(np.array([0.0, 2.0, 4.0]), np.array([1.0, 4.0])).round(3)
    array([[0.5, 0.5, 0. ],
           [0. , 0. , 1. ]])
    """
    from scipy.interpolate import make_interp_spline

    apart = np.maximum.accumulate(knots) + 1e-6 * np.arange(len(knots))
    line = make_interp_spline(apart, np.eye(len(knots)), k=1)
    return np.asarray(line(at, extrapolate=True))


def _slopes(x: Array, y: Array) -> Array:
    """dy/dx at each point by central differences; equal x are separated by 1e-6."""
    apart = np.maximum.accumulate(x) + 1e-6 * np.arange(len(x))
    return np.abs(np.gradient(y, apart))
