"""One site's curves for any tissue and effects: out of a few simulations, interpolated and shifted.

The law's exponent m is solved at a handful of values and interpolated; c scales force and
modulus exactly. An effect of the law changes the curves as the kept deformation says
(`effects.frozen`); one of the mesh or the contact is solved. After a refit the model with the
effect in it is solved once as it stands, and what the stand-in missed is put right.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any
from typing import Protocol as Typed

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from limbcli.diagnostics.bench import Explanation
from limbcli.effects.base import Effect, Parameter, Theta, point_name
from limbcli.effects.reading import Curves, Reading
from limbcli.errors import SolveError
from limbcli.model import Array
from limbcli.progress import SILENT, Progress
from limbcli.stages.diagnosis_curves import FIRST_M, Ingredients, _touches_loads
from limbcli.stages.diagnosis_data import SiteData
from limbcli.stages.diagnosis_sinking import Sinking
from limbcli.stages.diagnosis_tie import Tie

_STEPS_ONE = (0.5, 1.0, 2.0, 4.0)
_STEPS_TWO = (-2.0, -1.0, 1.0, 2.0)
_OF_LEVELS = ("force", "swe", "map", "travel")
_BEND, _NEAR = 8.0, 5  # m at which the one turns into the other; solved values that are used


class Book(Typed):
    """What curves come out of: solved ones, and first-order changes of them."""

    c: float

    @property
    def spent(self) -> bool: ...

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
            total = total + (x * linear if spline is None else _within(spline, x))
        return np.asarray(total)


def _within(spline: CubicSpline, x: float) -> Array:
    """The spline between its ends, its tangent beyond them."""
    inside = float(np.clip(x, spline.x[0], spline.x[-1]))
    return np.asarray(spline(inside) + (x - inside) * spline(inside, 1))


class SiteCurves:
    """One site's data beside one book of curves; `tie`: from the working mesh to the site's own; `sinking`:
    of the probe into the book's models."""

    def __init__(
        self, site: SiteData, book: Book, effects: Mapping[str, Effect], *, tie: Tie | None = None,
        sinking: Sinking | None = None, progress: Progress = SILENT,
    ):  # fmt: skip
        self.site, self.book, self.effects, self.tie, self.progress = site, book, effects, tie, progress
        self.sinking = sinking
        self.m_reference = 2.0
        self.nodes: dict[float, Curves] = {}
        self._changes: dict[tuple[str, str], Change] = {}
        self._repairs: dict[tuple[Explanation, str], Array] = {}

    def solve_nodes(self, values: Sequence[float]) -> None:
        """Solve at these m, the stiffest law first; what fails is left out, unless all do.

        Raises
        ------
        SolveError
            If none is solved.
        """
        problem = None
        for m in sorted(values, reverse=True):
            try:
                self.nodes[m] = self.book.curves(m)
            except SolveError as error:
                problem = error
        if not self.nodes and problem is not None:
            raise problem

    def solve_node(self, m: float) -> bool:
        """Solve at one m more; whether that went well."""
        try:
            self.nodes[m] = self.book.curves(m)
        except SolveError:
            return False
        return True

    def predict(
        self, c: float, m: float, explanation: Explanation, theta: Theta, points: Sequence[Theta]
    ) -> Array:
        """What this site's data should be (n,)."""
        curves = self.curves(c, m, explanation, theta, points)
        found = self.site.predict(curves, self.reading(explanation, theta, points))
        for k, (name, point) in enumerate(zip(explanation, points, strict=True)):
            share = point.get(self.effects[name].onset, 0.0)
            if share > 0.0:
                rest = [each for n, each in enumerate(points) if n != k]
                without = self.predict(c, m, (*explanation[:k], *explanation[k + 1 :]), theta, rest)
                found = np.where(self._before(share), without, found)
        return found

    def _before(self, share: float) -> NDArray[np.bool_]:
        """Data (n,) of the levels before that share of them."""
        first = share * len(self.site.protocol)
        return np.array([row.channel in _OF_LEVELS and row.level < first for row in self.site.rows])

    def curves(
        self, c: float, m: float, explanation: Explanation, theta: Theta, points: Sequence[Theta]
    ) -> Curves:
        """The stand-in's curves with these values."""
        depth, values, plain = self._base(m)
        values = values + self._repairs.get((explanation, label(points)), 0.0)
        for name, point in zip(explanation, points, strict=True):
            if self.effects[name].solves:
                values = values + self._change(self.effects[name], point).at(theta)
        log_force, log_speed = values[:, 0], values[:, 1:]
        force = np.concatenate([[0.0], np.exp(log_force[1:])])
        times = c / self.book.c
        taller = 1.0 if self.tie is None else self.tie.thickness_ratio
        thickness = plain.thickness * taller * (1.0 + theta.get("thickness_change", 0.0))
        log_speed = log_speed + 0.5 * np.log(times)
        found = Curves(depth, force * times, log_speed, plain.window_depth, thickness)
        return found if self.sinking is None else self.sinking.without(found, force)

    def reading(self, explanation: Explanation, theta: Theta, points: Sequence[Theta]) -> Reading:
        reading = Reading()
        for name, point in zip(explanation, points, strict=True):
            reading = self.effects[name].observe(reading, {**point, **theta})
        return reading

    def repair(self, m: float, explanation: Explanation, theta: Theta, points: Sequence[Theta]) -> None:
        """Solve the model with these effects as it stands, and let the stand-in give the same there.

        Raises
        ------
        SolveError
            If the simulation fails.
        """
        effects = [self.effects[name] for name in explanation]
        solving = tuple(
            (e, {**e.null, **{k: v for k, v in theta.items() if k in e.null}, **e.without_onset(q)})
            for e, q in zip(effects, points, strict=True)
            if e.solves
        )
        true = logs(self.book.curves(m, solving)) + self._tied()
        missed = true - logs(self.curves(self.book.c, m, explanation, theta, points))
        missed[0, 0] = 0.0
        key = (explanation, label(points))
        self._repairs[key] = self._repairs.get(key, 0.0) + np.nan_to_num(missed)

    def inherit(
        self, old: Explanation, old_points: Sequence[Theta], new: Explanation, points: Sequence[Theta]
    ) -> None:
        """A larger explanation starts with the repair of the one it grew from."""
        known = self._repairs.get((old, label(old_points)))
        if known is not None:
            self._repairs.setdefault((new, label(points)), known)

    def inherit_parts(self, explanation: Explanation, points: Sequence[Theta]) -> None:
        """A larger explanation not solved yet starts with what is known of its parts: the largest one that
        was solved, and the rest one by one."""
        n = len(explanation)
        if n < 2 or (explanation, label(points)) in self._repairs:
            return
        left, total = set(range(n)), None
        for size in range(n - 1, 0, -1):
            for part in itertools.permutations(range(n), size):
                key = (tuple(explanation[k] for k in part), label([points[k] for k in part]))
                if left.issuperset(part) and key in self._repairs:
                    total = self._repairs[key] if total is None else total + self._repairs[key]
                    left -= set(part)
        if total is not None:
            self._repairs[(explanation, label(points))] = total

    # ------------------------------------------------------------

    def _tied(self) -> Array | float:
        return 0.0 if self.tie is None else np.column_stack([self.tie.log_force, self.tie.log_speed])

    def _base(self, m: float) -> tuple[Array, Array, Curves]:
        """Depths, (ln force, ln speeds...) at m between the solved values, and a solved set."""
        nodes = sorted(self.nodes, key=lambda node: abs(bend(node) - bend(m)))[:_NEAR]
        first = self.nodes[nodes[0]]
        at, total = bend(np.array(nodes)), np.zeros_like(logs(first))
        for i, node in enumerate(nodes):
            others = np.delete(at, i)
            total += np.prod((bend(m) - others) / (at[i] - others)) * logs(self.nodes[node])
        return first.depth, total + self._tied(), first

    def _change(self, effect: Effect, point: Theta) -> Change:
        point = effect.without_onset(point)
        key = (effect.name, point_name(point))
        if key not in self._changes:
            self._changes[key] = self._solved_change(effect, point)
        return self._changes[key]

    def _solved_change(self, effect: Effect, point: Theta) -> Change:
        if effect.febio_only:
            raise only_febio(effect)
        self.progress.event("note", text=f"sensitivity to {effect.name} {point_name(point)}".rstrip())
        splines = {}
        for p in effect.parameters:
            if effect.new_mesh or _touches_loads(effect):
                splines[p.name] = self._by_solving(effect, point, p.name)
            else:
                splines[p.name] = self._by_shifting(effect, point, p.name)
        return Change(splines)

    def _by_solving(self, effect: Effect, point: Theta, name: str) -> tuple[None, Array, Array]:
        p = next(each for each in effect.parameters if each.name == name)
        theta = {**effect.null, **point, name: p.start}
        # a change hardly depends on m, and at one of these it serves other measurements too
        m = min(FIRST_M, key=lambda each: abs(np.log(each / self.m_reference)))
        moved = logs(self.book.curves(m, ((effect, theta),)))
        change = moved - logs(self.book.curves(m))
        return None, np.array([p.null, p.start - p.null]), np.nan_to_num(change)

    def _by_shifting(self, effect: Effect, point: Theta, name: str) -> tuple[CubicSpline, Array, Array]:
        p = next(each for each in effect.parameters if each.name == name)
        step = p.start - p.null
        known = np.isfinite(logs(self.nodes[self.m_reference]))
        places, values, problem = [0.0], [np.zeros(known.shape)], None
        for times in _STEPS_ONE if p.sign else _STEPS_TWO:
            value = p.null + times * step
            if not p.low - 1e-12 <= value <= p.high + 1e-12:
                continue
            theta = {**effect.null, **point, name: value}
            try:
                moved = np.column_stack(self.book.shift(self.m_reference, ((effect, theta),)))
            except SolveError as error:  # too large a step; smaller ones tell the change
                problem = error
                continue
            moved = filled(np.where(known, moved, 0.0))
            if np.isfinite(moved).all():
                places.append(times)
                values.append(moved)
        if len(places) < 2 and problem is not None:
            raise problem
        if len(places) < 2:
            raise SolveError(
                f"no wave can run, or the law has no answer, with {name} near {p.start:g}",
                where=f"effect {effect.name}", fix="look at the deepest level",
            )  # fmt: skip
        order = np.argsort(places)
        table = np.array(values)[order]
        if effect.spreads:
            table += np.multiply.outer(np.array(places)[order], self._missed(effect, point, p))
        return CubicSpline(np.array(places)[order], table), np.array([p.null, step]), table[0]

    def _missed(self, effect: Effect, point: Theta, p: Parameter) -> Array:
        """What the kept deformation does not tell of a change: from one solve at the start value."""
        m, theta = self.m_reference, {**effect.null, **point, p.name: p.start}
        try:
            true = logs(self.book.curves(m, ((effect, theta),))) - logs(self.book.curves(m))
            missed = true - np.column_stack(self.book.shift(m, ((effect, theta),)))
        except SolveError:
            return np.zeros_like(logs(self.nodes[m]))
        missed[0, 0] = 0.0
        return np.nan_to_num(missed)


def only_febio(effect: Effect) -> SolveError:
    return SolveError(
        "only FEBio can run it, and the diagnosis works with the reference solver",
        where=f"effect {effect.name}", fix="run the written model with FEBio",
    )  # fmt: skip


def bend(m: Any) -> Any:
    """Of m, what ln force and ln speed follow evenly: the law is even in m, an exponential of it where large.

    Polynomials in it through m 2, 5, 10 give force and speed within 0.3 % from 1 to 9; in ln m within 80 %.
    """
    return np.sqrt(_BEND**2 + np.square(m))


def logs(curves: Curves) -> Array:
    """(n, 1 + n_parts): ln force (0 at depth 0) and ln speeds."""
    log_force = np.zeros(len(curves.depth))
    log_force[1:] = np.log(np.maximum(curves.force[1:], 1e-9))
    return np.column_stack([log_force, curves.log_speed])


def filled(moved: Array) -> Array:
    """Changes (n, 1 + n_parts) with gaps closed by the nearest depths of the same part: no wave, few cells.

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


def label(points: Sequence[Theta]) -> str:
    """The points of the effects' grids in words."""
    return "; ".join(point_name(point) for point in points if point)
