"""Changes of a site's curves by effects as functions of their parameters, to first order or by a simulation.

The change by an effect of the material law is evaluated at the stored deformation
(`effects.frozen_deformation`); an effect of the mesh or the contact is simulated at its start value.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from limbcli.diagnosis.curves.curve_plan import FIRST_M, nearest_m
from limbcli.diagnosis.curves.site_simulations import SiteSimulations
from limbcli.effects.curves import Curves, gaps_filled
from limbcli.effects.effect import Effect, Parameter, Theta, point_name
from limbcli.effects.ingredients import Ingredients, stiffness_fields, touches_loads
from limbcli.effects.stiffness_places import Places
from limbcli.errors import SolveError
from limbcli.model import Array, LimbModel
from limbcli.progress import Progress

_REMEMBERED = 8  # number of parameter values cached
_STEPS_ONE = (0.5, 1.0, 2.0, 4.0)  # spline knots of a one-sided parameter, in units of its start value
_STEPS_TWO = (-2.0, -1.0, 1.0, 2.0)  # the same for a two-sided parameter
_MOST_SHOWN = 2 / 3  # fraction of the speeds shown without an effect that must be shown with it
_SAMPLES = 240  # number of sampling points along the beam
_LEFT = 0.03  # smallest depth of a line under load, as a fraction of its depth at rest
_BEYOND = 2.0  # length of the compressed column where no bone is known, as a multiple of the deepest border
_ROUNDED = 0.2  # smoothing width of |x| about 0, in units of the start value: a degree of tilt


Change = Callable[[Theta], Array]  # of ln force and ln speed (`logs`), at values of an effect's parameters


def _two_sided(p: Parameter, there: Array, other: Array) -> Callable[[float], Array]:
    """Change by a two-sided parameter from those at its start value and as far on the other side of null.

    Their odd and even parts are proportional to the distance from null; the even part, of whichever edge
    touches first, is smoothed about null. On a limb (m 4, tilted about the probe's long axis by 5, -5 and 10
    degrees) ln force at 7 of 39 mm changes by -0.038, -0.010 and -0.079.
    """
    odd, even = 0.5 * (there - other), 0.5 * (there + other)

    def at(value: float) -> Array:
        x = (value - p.null) / (p.start - p.null)
        size = (np.hypot(x, _ROUNDED) - _ROUNDED) / (np.hypot(1.0, _ROUNDED) - _ROUNDED)
        return np.asarray(x * odd + size * even)

    return at


def _between(p: Parameter, times: Array, table: Array) -> Callable[[float], Array]:
    """Spline through changes at distances from null, in units of the start value's; linear beyond."""
    spline = CubicSpline(times, table)

    def at(value: float) -> Array:
        x = (value - p.null) / (p.start - p.null)
        inside = float(np.clip(x, spline.x[0], spline.x[-1]))
        return np.asarray(spline(inside) + (x - inside) * spline(inside, 1))

    return at


class Changes:
    """Changes by effects in one site's simulations, at the stored deformation of the exponent `m`;
    not_simulated : effects that redistribute the load -> why the simulation that shows this has no solution
    """

    def __init__(self, simulations: SiteSimulations, *, progress: Progress):
        self.simulations, self.progress = simulations, progress
        self.m = 2.0
        self.not_simulated: dict[str, str] = {}
        self._known: dict[tuple[str, str], Change] = {}

    def of(self, effect: Effect, point: Theta) -> Change:
        """Change by an effect at one point of its grid.

        Raises SolveError if a simulation fails, or the law has no solution near the effect's start value.
        """
        point = effect.without_onset(point)
        key = (effect.name, point_name(point))
        if key not in self._known:
            self._known[key] = self._solved_change(effect, point)
        return self._known[key]

    def _solved_change(self, effect: Effect, point: Theta) -> Change:
        if effect.febio_only:
            raise only_febio(effect)
        self.progress.event("note", text=f"sensitivity to {effect.name} {point_name(point)}".rstrip())
        if effect.stiffness is not None:
            return self._of_field(effect, point)
        of_solves = effect.new_mesh or touches_loads(effect, self.simulations.model)
        of = self._by_solving if of_solves else self._by_shifting
        parts = [(p.name, of(effect, point, p)) for p in effect.parameters]
        return lambda theta: np.asarray(sum(part(theta[name]) for name, part in parts))

    def _of_field(self, effect: Effect, point: Theta) -> Change:
        """Change by an effect that is a factor on all stiffnesses, at any values of its parameters.

        The error of the stored deformation against a simulation is in proportion to the first parameter.
        """
        m, simulations, size, start = self.m, self.simulations, effect.sizes[0], effect.start
        names = [p.name for p in effect.parameters]
        # Layers depend on the deformation itself, so that a simulation is needed.
        solves = effect.spreads or simulations.curves(m).log_line is not None
        missed = self._missed(effect, point, size) if solves else None

        @lru_cache(_REMEMBERED)
        def at(*values: float) -> Array:
            theta = dict(zip(names, values, strict=True))
            moved = gaps_filled(shifted(simulations, m, ((effect, {**point, **theta}),)))
            if missed is None:
                return moved
            return moved + (theta[size.name] - size.null) / (size.start - size.null) * missed

        return lambda theta: at(*(float(theta.get(name, start[name])) for name in names))

    def _by_solving(self, effect: Effect, point: Theta, p: Parameter) -> Callable[[float], Array]:
        """From a simulation at the start value; if two-sided, also from one opposite, where it is solved."""
        there = self._solved_at(effect, point, p, p.start)
        if p.both_sides:
            with contextlib.suppress(SolveError):
                return _two_sided(p, there, self._solved_at(effect, point, p, 2.0 * p.null - p.start))
        return lambda value: p.proportional(value) / p.proportional(p.start) * there

    def _solved_at(self, effect: Effect, point: Theta, p: Parameter, value: float) -> Array:
        """Change of `logs` by one value of a parameter, from a simulation."""
        theta = {**effect.null, **point, p.name: value}
        # the change hardly depends on m, and at one of these values it can be reused for other measurements
        m = nearest_m(FIRST_M, self.m)
        moved = logs(self.simulations.curves(m, ((effect, theta),)))
        change = gaps_filled(moved - logs(self.simulations.curves(m)))
        if effect.new_mesh:
            change = without_spikes(self.simulations, change)
        return change

    def _by_shifting(self, effect: Effect, point: Theta, p: Parameter) -> Callable[[float], Array]:
        step = p.start - p.null
        known = np.isfinite(logs(self.simulations.curves(self.m)))
        places, values, problem = [0.0], [np.zeros(known.shape)], None
        for times in _STEPS_ONE if p.sign else _STEPS_TWO:
            value = p.null + times * step
            if not p.low - 1e-12 <= value <= p.high + 1e-12:
                continue
            theta = {**effect.null, **point, p.name: value}
            try:
                moved = shifted(self.simulations, self.m, ((effect, theta),))
            except SolveError as error:  # step too large; smaller ones suffice
                problem = error
                continue
            moved = np.where(known, moved, np.nan)
            if _is_known(moved, known):
                places.append(times)
                values.append(gaps_filled(moved))
        if len(places) < 2:
            raise problem or SolveError(
                f"no wave can propagate, or the law has no solution, with {p.name} near {p.start:g}",
                where=f"effect {effect.name}", fix="check the deepest level",
            )  # fmt: skip
        order = np.argsort(places)
        table = np.array(values)[order]
        if effect.spreads:
            table += np.multiply.outer(np.array(places)[order], self._missed(effect, point, p))
        return _between(p, np.array(places)[order], table)

    def _missed(self, effect: Effect, point: Theta, p: Parameter) -> Array:
        """Error of the change from the stored deformation, from one simulation at the start value."""
        m, theta = self.m, {**effect.null, **point, p.name: p.start}
        try:
            if self.simulations.spent:
                raise SolveError(
                    "the simulations used up the diagnosis's work budget",
                    where=f"effect {effect.name}", fix=f"name it: `--effects {effect.name}`",
                )  # fmt: skip
            true = logs(self.simulations.curves(m, ((effect, theta),))) - logs(self.simulations.curves(m))
            missed = true - shifted(self.simulations, m, ((effect, theta),))
        except SolveError as error:
            self.not_simulated[effect.name] = error.what
            return np.zeros_like(logs(self.simulations.curves(m)))
        missed[0, 0] = 0.0
        return gaps_filled(missed)


def only_febio(effect: Effect) -> SolveError:
    return SolveError(
        "only FEBio can run it, and the diagnosis was made without it",
        where=f"effect {effect.name}", fix="install FEBio 4 and diagnose with --solver febio",
    )  # fmt: skip


def shifted(simulations: SiteSimulations, m: float, ingredients: Ingredients) -> Array:
    """First-order change of `logs` by effects: (n, 1 + n_parts + n_lines)."""
    moved, curves = np.column_stack(simulations.shift(m, ingredients)), simulations.curves(m)
    if curves.log_line is None:
        return moved
    return np.column_stack([moved, line_shift(simulations.model, curves, ingredients)])


def line_shift(model: LimbModel, curves: Curves, ingredients: Ingredients) -> Array:
    """Approximate change of the lines' ln depths (n, n_lines) by effects, without a simulation.

    Below the probe's centre the layers bear nearly the same pressure, like springs in series: tissue softer
    by a factor is compressed more by that factor. Effects that are no stiffness field do not move the lines.
    Simulations correct the error of this estimate (`Changes`, `SiteCurves.repair`).

    Source: Neumann et al. 2023, PLOS One 18(4):e0284721 (springs in series as layered tissue under a probe).
    """
    assert curves.log_line is not None
    below = np.exp(curves.log_line)
    fields = stiffness_fields(ingredients)
    if not fields:
        return np.zeros_like(below)
    rest = below[0]
    end = curves.thickness if curves.thickness > rest[-1] else _BEYOND * rest[-1]
    z = (np.arange(_SAMPLES) + 0.5) / _SAMPLES * end
    places = Places(np.column_stack([np.zeros((_SAMPLES, 2)), -z]), model)
    softer = np.ones(_SAMPLES)
    for each in fields:
        softer = softer / np.maximum(each(places), 1e-6)
    knots = np.r_[0.0, rest, end]
    lost = np.column_stack([np.zeros(len(below)), rest - below, curves.depth])
    of_part = np.searchsorted(knots, z, side="right") - 1
    rates = np.diff(lost, axis=1) / np.diff(knots)
    squeezed = np.maximum(rates[:, of_part], 0.0)

    def left(weight: Array) -> Array:
        """Depths (n, n_lines) of the lines in mm for this relative compression at each sampling point."""
        lost = np.cumsum(weight, axis=1) / np.maximum(weight.sum(axis=1, keepdims=True), 1e-12)
        share = np.array([np.interp(rest, z + 0.5 * end / _SAMPLES, row) for row in lost])
        return np.maximum(rest - curves.depth[:, None] * share, _LEFT * rest)

    return np.asarray(np.log(left(squeezed * softer) / left(squeezed)))


def logs(curves: Curves) -> Array:
    """ln force (0 at depth 0), ln speeds, and ln depths of lines if tracked: (n, 1 + n_parts + n_lines)."""
    log_force = np.zeros(len(curves.depth))
    log_force[1:] = np.log(np.maximum(curves.force[1:], 1e-9))
    return np.column_stack([log_force, curves.columns])


def without_spikes(simulations: SiteSimulations, change: Array) -> Array:
    """A change of `logs` between meshes, with the speeds median-filtered over neighbouring parts."""
    speeds = slice(1, 2 + simulations.windows.n_parts)
    out = change.copy()
    out[:, speeds] = simulations.windows.without_spikes(gaps_filled(change[:, speeds]))
    return out


def _is_known(moved: Array, known: NDArray[np.bool_]) -> bool:
    """Whether a change (n, 1 + n_parts) has all forces, and most of the speeds that are known without it."""
    found = np.isfinite(moved)
    return bool(found[:, 0].all() and found.sum() >= _MOST_SHOWN * known.sum())
