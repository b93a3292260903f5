"""Simulated curves of a site for any law and effects, cached on disk by the content of their models.

All stiffnesses are multiples of c, so that force and modulus are proportional to c and a single
reference c is simulated. A diagnosis works on a mesh coarser than the site's own; a comparison of the
two meshes corrects force and speed.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from limbcli.effects.base import applied
from limbcli.effects.curves import Curves, continued
from limbcli.effects.frozen_deformation import SolvedDeformation, frozen_force, frozen_speed
from limbcli.errors import SolveError
from limbcli.feb.settings import schedule
from limbcli.model import Array, LimbModel
from limbcli.progress import SILENT, Progress
from limbcli.solvers.session import ReferenceSession
from limbcli.stages.diagnosis.curves.curve_plan import LevelsAt, Reach, Solving
from limbcli.stages.diagnosis.curves.exponents import bend
from limbcli.stages.diagnosis.curves.keys import READING_OF_FIELDS, changed_to, fingerprint
from limbcli.stages.diagnosis.curves.node_table import FILE, NodeTable
from limbcli.stages.diagnosis.curves.simulated_effects import (
    Ingredients,
    fields,
    has_fitted_size,
    is_numerical,
    is_of_law_alone,
)
from limbcli.stages.diagnosis.curves.store import CurveStore
from limbcli.stages.diagnosis.curves.work_budget import Work
from limbcli.stages.diagnosis.data.layers import BorderLines
from limbcli.stages.diagnosis.data.windows import Windows
from limbcli.stages.site_model.indentation_model import (
    indentation_model,
    starting_depth,
    with_penalty,
    with_tissue,
)
from limbcli.stages.site_model.model_simplification import fewer_steps, softer_jumps

if TYPE_CHECKING:
    from limbcli.solvers.restart import Solved

# Exponents m that are simulated first at every site; values between are interpolated, others are simulated
# when needed. The stiffer law stays stable to larger depths, and its solutions are initial guesses for the
# softer ones.
FIRST_M, USUAL_M = (8.0, 4.0), 4.0
_PATH_STEPS = 2  # load steps per depth in models with friction
_STALLED = 5.0  # tolerance where contact points chatter, as a multiple of the usual tolerance
# Contact penalty as a multiple of the usual one, which was chosen for FEBio at m 2: the stiffer the tissue
# becomes, the deeper the probe penetrates it. At m 5 and a depth of 14 of 38 mm the usual penalty lowers the
# force by 22 %, four times this penalty by 10 %.
_CONTACT_STIFFER = 4.0
_MOST_CHANGE = 10.0  # largest factor on the force at fixed deformation: stretched cells, exponential laws


@dataclass(frozen=True, eq=False)
class _Plain:
    """The model without effects at one m, and its results at its own deformation: force (n,) in N, log_speed
    (n, n_parts)."""

    model: LimbModel
    force: Array
    log_speed: Array


class SiteSimulations:
    """Curves of one site on one working mesh.

    Parameters
    ----------
    meshed : the site's model as `mesh` makes it; depths : mm, of the levels to simulate
    reach : how far to simulate. Where the solver stops short of the depth needed, but beyond enough of it,
        curves are extrapolated along those of a stiffer law, or of the model without effects: `in_part` lists
        these
    c : MPa, the reference stiffness; keep : cache folder of solved curves
    borders : layer borders to track
    """

    def __init__(
        self, meshed: LimbModel, depths: Sequence[float], *, c: float, f_kappa: float = 100.0,
        density_kg_per_m3: float = 1000.0, windows: Windows = Windows(), keep: Path | None = None,
        progress: Progress = SILENT, borders: BorderLines | None = None,
        reach: Reach = Reach(), solving: Solving = Solving(),
    ):  # fmt: skip
        plan = schedule(list(depths), start=starting_depth(meshed, depths[0]))
        model = indentation_model(meshed, plan, c=c, f_kappa=f_kappa, m=2.0)
        self._table = NodeTable.of(model, windows, density_kg_per_m3)
        model = with_penalty(model, solving.penalty or _CONTACT_STIFFER * model.contacts[0].penalty)
        followed = () if borders is None else (borders.record(model),)
        self.model = replace(model, records=(*model.records[:1], self._table.record, *followed))
        self.borders = borders
        self.c, self.f_kappa, self.density, self.windows = c, f_kappa, density_kg_per_m3, windows
        self.work = Work(n_cells=len(model.mesh.solid_blocks[0].cells))
        self.beside, self.enough_force = reach.beside, reach.enough_force
        self.kept, self.progress = CurveStore(keep), progress
        self.solving = solving
        self.depths = [float(each) for each in depths]
        self.n_solves, self.n_depths = 0, len(depths)
        self.needed = self.depths[-1] if reach.needed is None else reach.needed
        self._full_effort, self._required = (
            min(int(np.searchsorted(self.depths, share * self.needed - 1e-9)) + 1, self.n_depths)
            for share in (1.0, reach.enough)
        )
        self.in_part: dict[str, float] = {}  # label of a model -> mm reached, where less than needed
        self._session: ReferenceSession | None = None
        self._leads: list[Solved] = []  # initial guesses from an earlier run
        self._levels: dict[str, Solved] = {}
        self._with_effects: dict[tuple[str, ...], str] = {}  # names of effects -> key of the last solve
        self._times, self._begin = plan.times, reach.begin
        self._known: dict[str, Curves] = {}
        self._failed: dict[str, SolveError] = {}
        self._changed: dict[str, str] = {}
        self._kinematics: dict[str, SolvedDeformation] = {}
        self._plain: dict[float, _Plain] = {}
        rest = None if borders is None else borders.rest
        self._fingerprint = fingerprint(
            self.model,
            depths,
            c,
            f_kappa,
            windows,
            enough_force=reach.enough_force,
            lines=rest,
            density_kg_per_m3=density_kg_per_m3,
        )

    def curves(self, m: float, ingredients: Ingredients = ()) -> Curves:
        """The curves with exponent m and these effects (at their parameter values) in the model.

        Raises
        ------
        SolveError
            If the simulation fails; the failure is cached too.
        """
        key = self._key(m, ingredients)
        if key in self._failed:
            raise self._failed[key]
        if key not in self._known:
            try:
                self._known[key] = self._load(key, m, ingredients) or self._solve(key, m, ingredients)
            except SolveError as error:
                self._failed[key] = error
                raise
        return self._known[key]

    def shift(self, m: float, ingredients: Ingredients) -> tuple[Array, Array]:
        """First-order change of ln force (n,) and ln speed (n, n_parts) by effects of the law.

        Evaluated at the deformation solved without them, so that no simulation is needed. The change of force
        at depth 0 is set to that of the first level.

        Raises
        ------
        SolveError
            If the force at fixed deformation changes by more than `_MOST_CHANGE` times.
        """
        kinematics = self.kinematics(m)
        plain = self._plain_at(m)
        laws = tuple(each for each in ingredients if each[0].stiffness is None)
        changed = self.model_with(m, laws) if laws else plain.model
        in_window = self.model_with(m, laws, waves=True) if laws else plain.model
        ratio = frozen_force(changed, kinematics, fields(ingredients))[1:] / plain.force[1:]
        if not np.all((ratio > 1 / _MOST_CHANGE) & (ratio < _MOST_CHANGE)):
            raise SolveError(
                f"it changes the force more than {_MOST_CHANGE:g} times at fixed deformation",
                where="diagnose", fix="smaller steps",
            )  # fmt: skip
        log_speed = frozen_speed(
            in_window, kinematics, fields(ingredients, waves=True), density_kg_per_m3=self.density
        )
        if laws:
            kinematics.forget(changed, in_window)
        added = np.log(ratio)
        return np.concatenate([added[:1], added]), log_speed - plain.log_speed

    def _plain_at(self, m: float) -> _Plain:
        if m not in self._plain:
            model, kinematics = self.model_with(m, ()), self.kinematics(m)
            self._plain[m] = _Plain(
                model, frozen_force(model, kinematics),
                frozen_speed(model, kinematics, density_kg_per_m3=self.density),
            )  # fmt: skip
        return self._plain[m]

    def kinematics(self, m: float) -> SolvedDeformation:
        """The tissue's deformation in the model without effects."""
        key = self._key(m, ())
        if key not in self._kinematics:
            curves = self.curves(m)
        if key not in self._kinematics:  # the curves were cached by an earlier run
            values = self.kept.displacements(key)
            if values is None:
                self._known[key] = self._solve(key, m, ())
            else:
                self._kinematics[key] = self._table.kinematics(self.model, curves.depth, values)
        return self._kinematics[key]

    @property
    def spent(self) -> bool:
        """Whether the simulations have used up the work budget of the diagnosis."""
        return self.work.spent

    def model_with(self, m: float, ingredients: Ingredients, *, waves: bool = False) -> LimbModel:
        return applied(with_tissue(self.model, c=self.c, f_kappa=self.f_kappa, m=m), ingredients, waves=waves)

    def levels(self, m: float) -> tuple[LimbModel, Mapping[float, Array]]:
        """The model without effects, and its displacements (n_points, 3) in mm by depth, where solved."""
        self.curves(m)
        solved = self._levels.get(self._key(m, ()))
        times = dict(zip(self._times, self.depths, strict=True))
        states = {} if solved is None else solved.states
        return self.model, {times[time]: state.u for time, state in states.items() if time in times}

    def close(self) -> None:
        if self._session is not None:
            self._session.close()
            self._session = None

    # ------------------------------------------------------------

    def _solve(self, key: str, m: float, ingredients: Ingredients) -> Curves:
        self.n_solves += 1
        model = softer_jumps(self.model_with(m, ingredients))
        if model.has_friction:
            model = fewer_steps(model, _PATH_STEPS * self.n_depths)
        numerical = is_numerical(ingredients)
        full_effort = self._required if numerical else self._full_effort
        # numerical effects (mesh, cut, contact) enter every verdict; only the work of candidates is limited
        limited = bool(ingredients) and not numerical
        fitted = limited and has_fitted_size(ingredients)
        self.work.begin(
            candidate=limited, has_friction=model.has_friction, fitted=fitted,
            needed=self._required / self.n_depths,
        )  # fmt: skip
        of_law_alone = is_of_law_alone(self.model, model)
        try:
            shared = self._shared()
            if self._begin is not None and not ingredients:
                shared.begin_beside(*self._elsewhere(self._begin, m))
            session = shared if of_law_alone else self._fresh(model)
            if not of_law_alone:
                session.start_like(shared)
            start_levels = self._levels_with(ingredients) if fitted and not model.has_friction else None
            try:
                result = session.solve(
                    model,
                    records=True,
                    required=self._required,
                    full_effort=full_effort,
                    keep_levels=not ingredients,
                    patient=not limited,
                    last=None if m == USUAL_M and not ingredients else full_effort,
                    enough_force=self.enough_force,
                    independent=True,
                    start_levels=start_levels,
                )
            finally:
                self.work.end()
                if not of_law_alone:
                    session.close()
        except ArithmeticError as error:
            raise SolveError(f"the law overflows ({error})", where="diagnose", fix="none") from error
        work = self.work.done
        table = result.simulation.nodes[FILE]
        found = np.abs(result.simulation.times[None, :] - result.must_points.times[:, None]).argmin(axis=1)
        offset = float(model.info.get("depth_offset_mm", 0.0))
        # in the precision of the cache, so that a resumed diagnosis continues with the same numbers
        values = table.values[found].astype(np.float32).astype(float)
        kinematics = self._table.kinematics(
            model, np.concatenate([[0.0], result.must_points.depths + offset]), values
        )
        laws = tuple(each for each in ingredients if each[0].stiffness is None)
        seen = fields(ingredients, waves=True)
        curves = self._table.curves(
            model, self.model_with(m, laws, waves=True), kinematics, result.must_points.forces, seen,
            self._plain_deformations(m) if seen else (),
        )  # fmt: skip
        if self.borders is not None:
            curves = replace(curves, log_line=self.borders.log_depths(model, result.simulation, found))
        n_reached = len(values)
        enough = self.enough_force is not None and curves.force[-1] >= self.enough_force
        if n_reached < self.n_depths:
            further = self.depths[n_reached:]
            like = None if enough and not ingredients else self._beside(m, ingredients)
            curves = continued(curves, further, like=like)
            values = np.concatenate([values, *[values[-1:]] * len(further)])
            kinematics = self._table.kinematics(model, curves.depth, values)
        if not ingredients:
            self.work.usual.append(work)
            self._kinematics[key] = kinematics
            self.kept.keep_displacements(key, values.astype(np.float32))
        if result.levels is not None and not numerical:
            self._levels[key] = result.levels
            self.kept.keep_levels(key, result.levels)
            if ingredients:
                self._with_effects[_names(ingredients)] = key
        n_reached = self.n_depths if enough else n_reached
        if n_reached < full_effort:
            self._report_level(m, ingredients, n_reached)
        self.kept.keep_curves(key, curves, work=work, n_reached=n_reached)
        return curves

    def _plain_deformations(self, m: float) -> list[tuple[float, SolvedDeformation]]:
        """Deformations without effects at the exponents `FIRST_M`, where solved, with their interpolation
        weights at this m."""
        found = []
        for first in sorted(FIRST_M):
            with contextlib.suppress(SolveError):
                found.append((first, self.kinematics(first)))
        if len(found) < len(FIRST_M):
            return [(1.0, each) for _, each in found[:1]]
        (low, softer), (high, stiffer) = found
        share = float(np.clip((bend(m) - bend(low)) / (bend(high) - bend(low)), 0.0, 1.0))
        return [(1.0 - share, softer), (share, stiffer)]

    def _elsewhere(self, levels: LevelsAt, m: float) -> tuple[LimbModel, Mapping[float, Array]]:
        """Levels on another mesh, with this model's times for the same depths."""
        model, displacements = levels(m)
        times = dict(zip(self.depths, self._times, strict=True))
        return model, {times[depth]: u for depth, u in displacements.items() if depth in times}

    def _beside(self, m: float, ingredients: Ingredients) -> Curves | None:
        """Curves along which incomplete ones are extrapolated; None if there are none.

        Those without effects, of another mesh, or of a stiffer law, which stays stable to larger depths.
        """
        if self.beside is not None and not ingredients:
            return self.beside(m)
        stiffer = min((each for each in FIRST_M if each > m), default=m)
        if not ingredients and stiffer == m:
            return None
        try:
            with self.work.aside():
                return self.curves(m if ingredients else stiffer)
        except SolveError:
            return None

    def _report_level(self, m: float, ingredients: Ingredients, n_reached: int) -> None:
        if n_reached >= self._full_effort:
            return
        words = " and ".join(effect.name for effect, _ in ingredients) or "no effect"
        name, reached = f"{words}, m {m:g}", self.depths[n_reached - 1]
        self.in_part[name] = reached
        text = f"{name}: solved to {reached:.1f} of {self.depths[self._full_effort - 1]:.1f} mm"
        self.progress.event("note", text=text)

    def _levels_with(self, ingredients: Ingredients) -> Solved | None:
        """Solved levels of the last simulation with these effects at any sizes, as initial guess.

        At first these are the sizes of the first-order estimate, then those of earlier fits. A repeated fit
        needs sizes close to the last ones.
        """
        key = self._with_effects.get(_names(ingredients))
        if key is not None and key not in self._levels:
            levels = self.kept.levels(key)
            if levels is not None:
                self._levels[key] = levels
        return None if key is None else self._levels.get(key)

    def _resume(self, key: str) -> None:
        """Load the solved levels of an earlier run as initial guesses of later solves, as in that run."""
        levels = self.kept.levels(key)
        if levels is None:
            return
        self._levels[key] = levels
        if self._session is None:
            self._leads.append(levels)
        else:
            self._session.lead(levels)

    def _shared(self) -> ReferenceSession:
        if self._session is None:
            self._session = self._fresh(self.model)
            for each in self._leads:
                self._session.lead(each)
        return self._session

    def _fresh(self, model: LimbModel) -> ReferenceSession:
        watched = self.progress.also(self.work)
        return ReferenceSession(
            model, progress=watched, tolerance=self.solving.tolerance,
            stalled=_STALLED * self.solving.tolerance, threads=self.solving.threads,
        )  # fmt: skip

    def _key(self, m: float, ingredients: Ingredients) -> str:
        parts = [
            [effect.name, {k: round(float(v), 9) for k, v in sorted(theta.items())}]
            for effect, theta in ingredients
        ]
        if fields(ingredients, waves=True):
            parts.append(["read", {"fields": READING_OF_FIELDS}])
        text = json.dumps([self._fingerprint, round(m, 9), parts], sort_keys=True)
        if ingredients and text not in self._changed:
            self._changed[text] = changed_to(
                *(self.model_with(m, ingredients, waves=w) for w in (False, True))
            )
        return hashlib.sha256((text + self._changed.get(text, "")).encode()).hexdigest()[:24]

    def _load(self, key: str, m: float, ingredients: Ingredients) -> Curves | None:
        found = self.kept.curves(key, n_depths=self.n_depths)
        if found is None:
            return None
        self.work.total += found.work
        if not ingredients:
            self.work.usual.append(found.work)
            self._resume(key)
        elif not is_numerical(ingredients):
            self._with_effects[_names(ingredients)] = key
        if not is_numerical(ingredients):
            self._report_level(m, ingredients, found.n_reached)
        return found.curves


def _names(ingredients: Ingredients) -> tuple[str, ...]:
    return tuple(effect.name for effect, _ in ingredients)
