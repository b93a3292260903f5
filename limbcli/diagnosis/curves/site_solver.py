"""Solves the models of one site, with any exponent and effects, each from levels of earlier solves."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from limbcli.diagnosis.curves.curve_plan import USUAL_M, Reach, SiteWork, Solving
from limbcli.diagnosis.data.windows import Windows
from limbcli.effects.curves import Curves
from limbcli.effects.effect import applied
from limbcli.effects.ingredients import (
    Ingredients,
    has_fitted_size,
    is_numerical,
    is_of_law_alone,
    names_of,
    stiffness_fields,
)
from limbcli.model import Array, LimbModel
from limbcli.model.npz_file import model_hash
from limbcli.progress import Progress
from limbcli.results import plain
from limbcli.site_model.indentation_model import fewer_steps, softer_jumps, with_tissue
from limbcli.solvers.session import ReferenceSession, SessionResult
from limbcli.solvers.session_options import Budget, BudgetSpent, StartFrom, StopWhen
from limbcli.solvers.solve_folder import SolveFolder
from limbcli.version import __version__

if TYPE_CHECKING:
    from limbcli.solvers.restart import Solved

_READING = 3  # version of the evaluation of speeds; increment on changes, as cached curves contain speeds
_READING_OF_FIELDS = 2  # the same for curves with an effect that is a factor on stiffnesses
_STALLED = 5.0  # tolerance where contact points chatter, as a multiple of the usual tolerance


@dataclass(frozen=True, eq=False, kw_only=True)
class SiteModels:
    """A site's model for any exponent m and effects, from the `usual` one without; c : MPa, and f_kappa, of
    its tissue; fingerprint : hash of what else the curves depend on"""

    usual: LimbModel
    c: float
    f_kappa: float
    fingerprint: str
    _contents: dict[str, str] = field(default_factory=dict)

    def of(self, m: float, ingredients: Ingredients = (), *, waves: bool = False) -> LimbModel:
        """waves : the model for wave speeds, in which an effect may have a separate law"""
        tissue = with_tissue(self.usual, c=self.c, f_kappa=self.f_kappa, m=m)
        return applied(tissue, ingredients, waves=waves)

    def to_solve(self, m: float, ingredients: Ingredients, times: Sequence[float]) -> LimbModel:
        """The model made easier to solve, for curves at these times (s); with friction by a load step for
        each: two change what friction does by 2 % of it."""
        model = softer_jumps(self.of(m, ingredients))
        model = replace(model, steps=tuple(replace(each, must_points=tuple(times)) for each in model.steps))
        return fewer_steps(model, len(times)) if model.has_friction else model

    def key(self, m: float, ingredients: Ingredients) -> str:
        """Hash of the exponent and of what the effects, as now implemented, make of the model."""
        parts = [
            [effect.name, {k: round(float(v), 9) for k, v in sorted(theta.items())}]
            for effect, theta in ingredients
        ]
        if stiffness_fields(ingredients, waves=True):
            parts.append(["read", {"fields": _READING_OF_FIELDS}])
        text = json.dumps([self.fingerprint, round(m, 9), parts], sort_keys=True)
        if ingredients and text not in self._contents:
            models = (self.of(m, ingredients, waves=waves) for waves in (False, True))
            self._contents[text] = model_hash(*models)
        return hashlib.sha256((text + self._contents.get(text, "")).encode()).hexdigest()[:24]


def fingerprint(
    model: LimbModel, depths: Sequence[float], *, c: float, f_kappa: float, windows: Windows,
    enough_force: float | None, lines: Array | None, density_kg_per_m3: float,
) -> str:  # fmt: skip
    """Hash of a site's simulations without effects: of all that their curves depend on, and of the versions
    of the program and of the evaluation of speeds."""
    digest = hashlib.sha256(np.ascontiguousarray(model.mesh.points).tobytes())
    digest.update(f"limbcli {__version__}, read {_READING}".encode())
    penalties = [each.penalty for each in model.contacts]
    contents = [[round(float(d), 6) for d in depths], c, f_kappa, repr(windows), penalties, enough_force]
    contents += [density_kg_per_m3]
    digest.update(json.dumps(contents if lines is None else [*contents, plain(lines)]).encode())
    return digest.hexdigest()[:16]


@dataclass(frozen=True, eq=False)
class Solve:
    """A solved model, its result, and the work it took."""

    model: LimbModel
    result: SessionResult
    work: int

    @property
    def depth(self) -> Array:
        """Depths (1 + n,) in mm from first touch, the first of which is 0."""
        offset = float(self.model.info.get("depth_offset_mm", 0.0))
        return np.concatenate([[0.0], self.result.must_points.depths + offset])


@dataclass(frozen=True, eq=False)
class SolvedCurves:
    """Curves, the work of their solve, and the number of depths it reached."""

    curves: Curves
    work: int
    n_reached: int

    @staticmethod
    def of(stored: Any) -> SolvedCurves:
        curves = Curves(
            stored["depth"], stored["force"], stored["log_speed"], stored["window_depth"],
            float(stored["thickness"]), stored.get("log_line", None),
        )  # fmt: skip
        return SolvedCurves(curves, int(stored["work"]), int(stored["n_reached"]))

    def arrays(self) -> dict[str, Any]:
        found = {**vars(self), **{each.name: getattr(self.curves, each.name) for each in fields(Curves)}}
        return {name: each for name, each in found.items() if name != "curves" and each is not None}


class SiteSolver:
    """Solver of one site's models. Those that differ from the usual one in their materials only share a
    session.

    Levels of the model without effects are initial guesses for all; those of the last solve with the same
    effects, for a fit's repeated solves. times : s, of the load steps, by depth in mm
    """

    def __init__(
        self, models: SiteModels, times: Mapping[float, float], *, reach: Reach, solving: Solving,
        keep: Path | None, progress: Progress,
    ):  # fmt: skip
        self.models, self.times, self.reach, self.solving = models, times, reach, solving
        self.memo, self.progress = SolveFolder(keep), progress
        self.work = SiteWork(n_cells=len(models.usual.mesh.solid_blocks[0].cells))
        self._session: ReferenceSession | None = None
        self._leads: list[Solved] = []  # initial guesses from an earlier run
        self._last_with: dict[tuple[str, ...], str] = {}  # names of effects -> key of the last solve

    def solve(self, m: float, ingredients: Ingredients, depths: Sequence[float]) -> Solve:
        """Solve one model at some of the depths (mm).

        Raises SolveError if not enough depths are reached; `BudgetSpent` if that is because of the work.
        """
        model = self.models.to_solve(m, ingredients, [self.times[depth] for depth in depths])
        n_full, n_required = (self.reach.down_to(depths, share=each) for each in (1.0, self.reach.enough))
        # numerical effects (mesh, cut, contact) enter every verdict; only the work of candidates is limited
        numerical = is_numerical(ingredients)
        candidate = bool(ingredients) and not numerical
        budget, start = Budget(allowed=self.work.at_most), None
        if numerical:
            n_full = n_required
        elif candidate:
            n_steps = len({*depths, *list(self.times)[-1:]})  # the last depth ends the load
            fitted, needed = has_fitted_size(ingredients), n_required / n_steps
            budget = self.work.of_candidate(has_friction=model.has_friction, fitted=fitted, needed=needed)
            # at sizes of the first-order estimate, then of earlier fits: a repeated fit is close to them
            key = self._last_with.get(names_of(ingredients)) if fitted and not model.has_friction else None
            start = None if key is None else self.memo.levels(key)
        try:
            with self._session_for(model, m, ingredients) as session:
                stop = StopWhen(
                    required=n_required, full_effort=n_full, patient=not candidate, budget=budget,
                    last=None if m == USUAL_M and not ingredients else n_full,
                    enough_force=self.reach.enough_force,
                )  # fmt: skip
                begin = StartFrom(levels=start, independent=True)
                result = session.solve(
                    model, records=True, stop=stop, start=begin, keep_levels=not ingredients
                )
        except BudgetSpent as error:
            raise BudgetSpent(
                "it requires several times the work of the model without it",
                where="diagnose", fix="run the written model separately", **error.facts,
            ) from error  # fmt: skip
        finally:
            self.work.total += budget.spent
        return Solve(model, result, budget.spent)

    def keep(self, key: str, ingredients: Ingredients, levels: Solved | None) -> None:
        """Keep the levels of a solve as initial guesses, in this run and later ones."""
        if levels is not None and not is_numerical(ingredients):
            self.memo.keep_levels(key, levels)
            if ingredients:
                self._last_with[names_of(ingredients)] = key

    def resume(self, key: str, ingredients: Ingredients) -> None:
        """Use the levels that an earlier run kept, as in that run."""
        if ingredients:
            if not is_numerical(ingredients):
                self._last_with[names_of(ingredients)] = key
        elif (levels := self.memo.levels(key)) is not None:
            self._leads.append(levels)
            if self._session is not None:
                self._session.lead(levels)

    def close(self) -> None:
        if self._session is not None:
            self._session.close()
            self._session = None

    @contextmanager
    def _session_for(
        self, model: LimbModel, m: float, ingredients: Ingredients
    ) -> Iterator[ReferenceSession]:
        """The shared session; for another mesh, contact or load one of its own, with the same guesses."""
        if self._session is None:
            self._session = self._new_session(self.models.usual)
            for each in self._leads:
                self._session.lead(each)
        if self.solving.beside is not None and not ingredients:
            other, levels = self.solving.beside.levels(m)
            at = {self.times[depth]: u for depth, u in levels.items() if depth in self.times}
            self._session.begin_beside(other, at)
        if is_of_law_alone(self.models.usual, model):
            yield self._session
            return
        with self._new_session(model) as own:
            own.start_like(self._session)
            yield own

    def _new_session(self, model: LimbModel) -> ReferenceSession:
        tolerance = self.solving.tolerance
        return ReferenceSession(
            model, progress=self.progress, tolerance=tolerance, stalled=_STALLED * tolerance,
            threads=self.solving.threads,
        )  # fmt: skip
