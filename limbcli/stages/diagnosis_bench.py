"""The diagnosis' bench for one site: fits and sensitivities out of a few simulations.

The law's exponent m is solved at a handful of values and interpolated; c scales force and
modulus exactly. An effect of the law changes the curves as the kept deformation says
(`effects.frozen`); one of the mesh or the contact is solved. After a refit the model with the
effect in it is solved once as it stands, what the stand-in missed is put right, and the fit is
repeated: reported numbers come from that.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Protocol as Typed

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import least_squares

from limbcli.diagnostics.bench import Data, Explanation, Facts, Fitted, Proposal
from limbcli.diagnostics.linear import Whitener
from limbcli.diagnostics.score import Direction
from limbcli.effects.base import Effect, Theta, point_name
from limbcli.effects.reading import Curves, Reading
from limbcli.errors import FitError, LimbError, SolveError
from limbcli.model import Array
from limbcli.progress import SILENT, Progress
from limbcli.stages.diagnosis_curves import Ingredients, _touches_loads
from limbcli.stages.diagnosis_data import SiteData
from limbcli.stages.diagnosis_numerics import Tie
from limbcli.units import kpa_from_mpa

M_BOUNDS = (1.0, 20.0)
_M_START = (2.0, 5.0)
_STEPS_ONE = (0.5, 1.0, 2.0, 4.0)
_STEPS_TWO = (-2.0, -1.0, 1.0, 2.0)
_DIFFERENCE = 1e-3
_ON_BOUND = 1e-3
_SETTLED = 0.03  # of m, between the estimate and the nearest solved value
_MAX_NODES = 4
_MOST_POINTS, _TRIED_FULLY = 60, 2  # combinations of the effects' grid points


class Book(Typed):
    """What curves come out of: solved ones, and first-order changes of them."""

    c: float

    def curves(self, m: float, ingredients: Ingredients = ()) -> Curves: ...

    def shift(self, m: float, ingredients: Ingredients) -> tuple[Array, Array]: ...


@dataclass(frozen=True, eq=False)
class Change:
    """What an effect at one point of its grid does to ln force and ln speed, a spline a parameter."""

    splines: Mapping[str, tuple[CubicSpline | None, Array, Array]]

    def at(self, theta: Theta) -> Array:
        total: Array | float = 0.0
        for name, (spline, null_and_step, linear) in self.splines.items():
            x = (theta[name] - null_and_step[0]) / null_and_step[1]
            total = total + (x * linear if spline is None else spline(x))
        return np.asarray(total)


class SiteBench:
    """One site's data against one book of curves; `tie`: from the working mesh to the site's own."""

    def __init__(
        self, site: SiteData, book: Book, effects: Sequence[Effect], *,
        tie: Tie | None = None, verify: bool = True, progress: Progress = SILENT,
    ):  # fmt: skip
        self.site, self.book, self.progress = site, book, progress
        self.effects = {each.name: each for each in effects if each.kind != "numerical"}
        self.verify = verify
        self.whiten = Whitener.of(site.data.noise.covariance)
        self.tie = tie
        self._correction = None if tie is None else (tie.log_force, tie.log_speed)
        self._taller = 1.0 if tie is None else tie.thickness_ratio
        self._nodes: dict[float, Curves] = {}
        self._changes: dict[tuple[str, str], Change] = {}
        self._repairs: dict[tuple[Explanation, str], Array] = {}
        self.m_reference = _M_START[0]
        self._base_end: tuple[float, float] | None = None

    # ------------------------------------------------------------ the contract

    @property
    def data(self) -> Data:
        return self.site.data

    @property
    def candidates(self) -> Sequence[Facts]:
        return [
            Facts(e.name, e.sentence, e.kind, {p.name: p.typical - p.null for p in e.parameters})
            for e in self.effects.values()
        ]

    def fit(self, explanation: Explanation, start: Mapping[str, float]) -> Fitted:
        """Least squares over c, m and the effects' parameters, at every point of the effects' grids."""
        if not explanation:
            return self._fit_base()
        effects = [self.effects[name] for name in explanation]
        combinations: list[Sequence[Theta]] = list(
            itertools.islice(itertools.product(*(e.grid for e in effects)), _MOST_POINTS)
        )
        if len(combinations) > _TRIED_FULLY:
            quick = self._each(explanation, combinations, start, thorough=False)
            combinations = [points for _, points, _ in quick[:_TRIED_FULLY]]
        best = self._each(explanation, combinations, start, thorough=True)[0]
        return self._verified(explanation, best[2])

    def _each(
        self, explanation: Explanation, combinations: Sequence[Sequence[Theta]], start: Mapping[str, float],
        *, thorough: bool,
    ) -> list[tuple[float, Sequence[Theta], Fitted]]:  # fmt: skip
        """Fits at these points of the effects' grids, the best first; points without an answer left out."""
        found, problem = [], None
        for points in combinations:
            try:
                cost, fitted = self._solve_fit(explanation, points, start, thorough=thorough)
            except LimbError as error:
                problem = error
                continue
            found.append((cost, points, fitted))
        if not found and problem is not None:
            raise problem
        return sorted(found, key=lambda each: each[0])

    def directions(self, fitted: Fitted, name: str) -> Sequence[Direction]:
        effect = self.effects[name]
        self._check_channels(effect)
        found = []
        for point in effect.grid:
            columns = [self._column(fitted, effect, p.name, point) for p in effect.parameters]
            names = tuple(p.name for p in effect.parameters)
            signs = tuple(p.sign for p in effect.parameters)
            found.append(Direction(np.stack(columns, axis=1), signs, point_name(point), names))
        return found

    def proposals(self, fits: Sequence[Fitted]) -> Sequence[Proposal]:
        from limbcli.stages.diagnosis_menu import menu

        return menu(self, fits)

    # ------------------------------------------------------------ curves

    def curves(
        self, c: float, m: float, explanation: Explanation, theta: Theta, points: Sequence[Theta]
    ) -> Curves:
        """The stand-in's curves with these values."""
        depth, values, plain = self._base(m)
        values = values + self._repairs.get((explanation, _label(points)), 0.0)
        for name, point in zip(explanation, points, strict=True):
            if self.effects[name].solves:
                values = values + self._change(self.effects[name], point).at(theta)
        log_force, log_speed = values[:, 0], values[:, 1:]
        force = np.concatenate([[0.0], np.exp(log_force[1:]) * c / self.book.c])
        thickness = plain.thickness * self._taller * (1.0 + theta.get("thickness_change", 0.0))
        return Curves(depth, force, log_speed + 0.5 * np.log(c / self.book.c), plain.window_depth, thickness)

    def reading(self, explanation: Explanation, theta: Theta, points: Sequence[Theta]) -> Reading:
        reading = Reading()
        for name, point in zip(explanation, points, strict=True):
            reading = self.effects[name].observe(reading, {**point, **theta})
        return reading

    def predict(self, x: Array, explanation: Explanation, points: Sequence[Theta]) -> Array:
        """x: ln c, ln m, then the effects' parameters in order."""
        theta = self._theta(x, explanation)
        curves = self.curves(float(np.exp(x[0])), float(np.exp(x[1])), explanation, theta, points)
        return self.site.predict(curves, self.reading(explanation, theta, points))

    def _theta(self, x: Array, explanation: Explanation) -> dict[str, float]:
        names = [p.name for name in explanation for p in self.effects[name].parameters]
        return dict(zip(names, x[2:].tolist(), strict=True))

    def _base(self, m: float) -> tuple[Array, Array, Curves]:
        """Depths, (ln force, ln speeds...) at m between the solved values, and a solved set."""
        nodes = sorted(self._nodes)
        first = self._nodes[nodes[0]]
        tables = np.array([_logs(self._nodes[node]) for node in nodes])
        near = np.argsort(np.abs(np.log(np.array(nodes) / m)))[:3]
        at, out = np.log(np.array(nodes)[near]), np.zeros_like(tables[0])
        for i in range(len(near)):
            others = [j for j in range(len(near)) if j != i]
            weight = np.prod([(np.log(m) - at[j]) / (at[i] - at[j]) for j in others]) if others else 1.0
            out = out + weight * tables[near[i]]
        if self._correction is not None:
            out = out + np.column_stack(self._correction)
        return first.depth, out, first

    def _change(self, effect: Effect, point: Theta) -> Change:
        key = (effect.name, point_name(point))
        if key not in self._changes:
            self._changes[key] = self._solved_change(effect, point)
        return self._changes[key]

    def _solved_change(self, effect: Effect, point: Theta) -> Change:
        if effect.febio_only:
            raise SolveError(
                "only FEBio can run it, and the diagnosis works with the reference solver",
                where=f"effect {effect.name}", fix="run the written model with FEBio",
            )  # fmt: skip
        self.progress.event("note", text=f"sensitivity to {effect.name} {point_name(point)}".rstrip())
        splines = {}
        for p in effect.parameters:
            step = p.start - p.null
            scale = np.array([p.null, step])
            if effect.new_mesh or _touches_loads(effect):
                theta = {**effect.null, **point, p.name: p.start}
                moved = _logs(self.book.curves(self.m_reference, ((effect, theta),)))
                splines[p.name] = (None, scale, moved - _logs(self.book.curves(self.m_reference)))
                continue
            places, values = [0.0], [np.zeros_like(_logs(self._nodes[self.m_reference]))]
            for times in _STEPS_ONE if p.sign else _STEPS_TWO:
                value = p.null + times * step
                if p.low - 1e-12 <= value <= p.high + 1e-12:
                    theta = {**effect.null, **point, p.name: value}
                    force, speed = self.book.shift(self.m_reference, ((effect, theta),))
                    moved = np.column_stack([force, speed])
                    moved[~np.isfinite(_logs(self._nodes[self.m_reference]))] = 0.0
                    moved = _filled(moved)
                    if np.isfinite(moved).all():
                        places.append(times)
                        values.append(moved)
            if len(places) < 2:
                raise SolveError(
                    f"no wave can run, or the law has no answer, with {p.name} near {p.start:g}",
                    where=f"effect {effect.name}", fix="look at the deepest level",
                )  # fmt: skip
            order = np.argsort(places)
            table = np.array(values)[order]
            splines[p.name] = (CubicSpline(np.array(places)[order], table), scale, table[0])
        return Change(splines)

    # ------------------------------------------------------------ fits

    def _fit_base(self) -> Fitted:
        for m in _M_START:
            self._solve_node(m)
        for _ in range(_MAX_NODES):
            fitted = self._solve_fit((), (), {})[1]
            m = fitted.values["m"]
            nearest = min(self._nodes, key=lambda node: abs(np.log(node / m)))
            if abs(np.log(nearest / m)) < _SETTLED or len(self._nodes) >= _MAX_NODES:
                break
            if not self._solve_node(float(round(m, 3))):
                break
        self.m_reference = min(self._nodes, key=lambda node: abs(np.log(node / fitted.values["m"])))
        self._base_end = (fitted.values["c_kpa"] / 1e3, fitted.values["m"])
        return fitted

    def _solve_node(self, m: float) -> bool:
        try:
            self._nodes[m] = self.book.curves(m)
        except SolveError:
            if not self._nodes:
                raise
            return False
        return True

    def _solve_fit(
        self, explanation: Explanation, points: Sequence[Theta], start: Mapping[str, float], *,
        thorough: bool = True,
    ) -> tuple[float, Fitted]:  # fmt: skip
        parameters = [p for name in explanation for p in self.effects[name].parameters]
        low = np.array([np.log(self.book.c / 20), np.log(M_BOUNDS[0]), *(p.low for p in parameters)])
        high = np.array([np.log(self.book.c * 20), np.log(M_BOUNDS[1]), *(p.high for p in parameters)])
        scale = np.array([0.1, 0.3, *(abs(p.start - p.null) for p in parameters)])
        guesses = [
            [p.null + start.get(p.name, 0.0) or p.start for p in parameters],
            [p.start for p in parameters],
        ]
        best = None
        for guess, (c, m) in itertools.product(guesses if parameters else [[]], self._tissue_starts()):
            x0 = np.clip(np.array([np.log(c), np.log(m), *guess]), low + 1e-6, high - 1e-6)
            found = least_squares(
                lambda x: self.whiten(self.data.y - self.predict(x, explanation, points)),
                x0, bounds=(low, high), x_scale=scale, diff_step=1e-4, max_nfev=60 if thorough else 12,
            )  # fmt: skip
            if best is None or found.cost < best.cost:
                best = found
            if not thorough:
                break
        assert best is not None
        if not np.isfinite(best.cost):
            raise FitError("the prediction is not a number", where="diagnose", fix="look at levels.csv")
        return 2 * float(best.cost), self._fitted(best.x, explanation, points, low, high)

    def _tissue_starts(self) -> list[tuple[float, float]]:
        """c, m to start from: where the fit without effects ended, and a usual tissue."""
        usual = [(self.book.c, 2.0), (self.book.c, 6.0)]
        if self._base_end is None:
            return usual
        m = self._base_end[1]
        return [self._base_end, max(usual, key=lambda each: abs(np.log(each[1] / m)))]

    def _fitted(
        self, x: Array, explanation: Explanation, points: Sequence[Theta], low: Array, high: Array
    ) -> Fitted:
        parameters = [p for name in explanation for p in self.effects[name].parameters]
        span = np.array([1.0, 1.0, *(p.high - p.low for p in parameters)])
        bound: list[str] = []
        for k, p in enumerate(parameters, start=2):
            at = (
                "low"
                if x[k] - low[k] < _ON_BOUND * span[k]
                else "high"
                if high[k] - x[k] < _ON_BOUND * span[k]
                else ""
            )
            single = len([q for q in parameters if q.sign]) < 2
            if at and (single or at == "high"):
                bound.append(f"{p.name} ended on its {at}er bound {low[k] if at == 'low' else high[k]:g}")
        free = np.ones(len(x), dtype=bool)
        free[1] = low[1] + 1e-4 < x[1] < high[1] - 1e-4
        notes = () if free[1] else (f"m ended on its bound {np.exp(x[1]):g} and is held there",)
        jacobian = self._jacobian(x, explanation, points)
        base_names = ("c", "m") if free[1] else ("c",)
        values = {"c_kpa": float(kpa_from_mpa(float(np.exp(x[0])))), "m": float(np.exp(x[1]))}
        values |= self._theta(x, explanation)
        values |= {k: float(v) for point in points for k, v in point.items()}
        return Fitted(
            explanation, self.predict(x, explanation, points), jacobian[:, free], base_names, values,
            tuple(p.name for p in parameters), tuple(bound), notes, {"grid": _label(points)},
        )  # fmt: skip

    def _jacobian(self, x: Array, explanation: Explanation, points: Sequence[Theta]) -> Array:
        parameters = [p for name in explanation for p in self.effects[name].parameters]
        steps = [
            _DIFFERENCE,
            _DIFFERENCE,
            *(_DIFFERENCE * max(abs(p.start - p.null), 1e-6) for p in parameters),
        ]
        columns = []
        for k, step in enumerate(steps):
            up, down = x.copy(), x.copy()
            up[k] += step
            down[k] -= step
            columns.append(
                (self.predict(up, explanation, points) - self.predict(down, explanation, points)) / (2 * step)
            )
        return np.stack(columns, axis=1)

    def _verified(self, explanation: Explanation, fitted: Fitted) -> Fitted:
        """Solve the model as fitted, repair the stand-in there, fit again; twice at most."""
        effects = [self.effects[name] for name in explanation]
        if not self.verify or not any(e.solves for e in effects) or fitted.at_bound:
            return fitted
        for _ in range(2):
            points = self._points(effects, fitted)
            theta = {**fitted.values}
            m = round(fitted.values["m"], 4)
            solving = tuple(
                (e, {**e.null, **theta, **q}) for e, q in zip(effects, points, strict=True) if e.solves
            )
            true = _logs(self.book.curves(m, solving))
            c = self.book.c
            stand_in = _logs(self.curves(c, m, explanation, theta, points))
            if self._correction is not None:
                true = true + np.column_stack(self._correction)
            key = (explanation, _label(points))
            missed = true - stand_in
            missed[0, 0] = 0.0
            self._repairs[key] = self._repairs.get(key, 0.0) + np.nan_to_num(missed)
            before = fitted.prediction
            fitted = self._solve_fit(explanation, points, {})[1]
            if np.max(np.abs(fitted.prediction - before) / self.data.deviation) < 0.1:
                break
        return fitted

    def _points(self, effects: Sequence[Effect], fitted: Fitted) -> list[Theta]:
        chosen: list[Theta] = []
        for effect in effects:
            match = [q for q in effect.grid if all(fitted.values.get(k) == v for k, v in q.items())]
            chosen.append(match[0] if match else effect.grid[0])
        return chosen

    def _column(self, fitted: Fitted, effect: Effect, name: str, point: Theta) -> Array:
        """Sensitivity at the effect's null by differences of the stand-in, around the fitted model."""
        p = next(each for each in effect.parameters if each.name == name)
        old = fitted.explanation
        points = [*self._points([self.effects[e] for e in old], fitted), point]
        explanation = (*old, effect.name)
        x = [np.log(fitted.values["c_kpa"] / 1e3), np.log(fitted.values["m"])]
        x += [fitted.values[q.name] for e in old for q in self.effects[e].parameters]
        k = len(x) + [q.name for q in effect.parameters].index(name)
        x += [q.null for q in effect.parameters]
        step = 0.02 * (p.start - p.null)
        up, down = np.array(x), np.array(x)
        up[k] += step
        if not p.sign:
            down[k] -= step
        inherited = self._repairs.get((old, _label(points[:-1])))
        if inherited is not None:
            self._repairs.setdefault((explanation, _label(points)), inherited)
        moved = self.predict(up, explanation, points) - self.predict(down, explanation, points)
        return np.asarray(moved / (up[k] - down[k]))

    def _check_channels(self, effect: Effect) -> None:
        lacking = [each for each in effect.needs if each not in self.site.channels]
        if lacking:
            raise FitError(
                f"it needs what was not measured: {', '.join(lacking)}",
                where=f"effect {effect.name}", fix="measure it, see the next measurement",
            )  # fmt: skip


def _logs(curves: Curves) -> Array:
    """(n, 1 + n_parts): ln force (0 at depth 0) and ln speeds."""
    log_force = np.zeros(len(curves.depth))
    log_force[1:] = np.log(np.maximum(curves.force[1:], 1e-9))
    return np.column_stack([log_force, curves.log_speed])


def _filled(moved: Array) -> Array:
    """Changes (n, 1 + n_parts) with gaps closed by the nearest depth of the same part: few cells, or no wave.

    Left as it is where the force, or more than a third of the speeds, is missing.
    """
    known = np.isfinite(moved)
    if not known[:, 0].all() or known.mean() < 2 / 3:
        return moved
    out, at = moved.copy(), np.arange(len(moved))
    for k in range(moved.shape[1]):
        here = known[:, k]
        out[:, k] = np.interp(at, at[here], moved[here, k]) if here.any() else 0.0
    return out


def _label(points: Sequence[Theta]) -> str:
    return "; ".join(point_name(point) for point in points if point)


__all__ = ["Book", "SiteBench", "replace"]
