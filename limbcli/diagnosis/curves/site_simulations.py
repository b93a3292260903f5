"""Simulated curves of a site for any law and effects, cached on disk by the content of their models.

All stiffnesses are multiples of c, so that force and modulus are proportional to c and a single
reference c is simulated. A diagnosis works on a mesh coarser than the site's own; a comparison of the
two meshes corrects force and speed.
"""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from limbcli.diagnosis.curves.curve_plan import FIRST_M, Reach, Solving, bend, nearest_m, where_solved
from limbcli.diagnosis.curves.site_solver import SiteModels, SiteSolver, Solve, SolvedCurves, fingerprint
from limbcli.diagnosis.data.windows import Windows
from limbcli.effects.curves import Curves, continued, filled
from limbcli.effects.frozen_deformation import (
    SolvedDeformation,
    frozen_force,
    frozen_speed,
    strain_concentrations,
)
from limbcli.effects.ingredients import Ingredients, is_numerical, laws, names_of, stiffness_fields
from limbcli.effects.stiffness_places import Stiffness
from limbcli.effects.tissue import thickness
from limbcli.errors import SolveError
from limbcli.feb.settings import schedule
from limbcli.model import Array, LimbModel, LogRecord
from limbcli.progress import SILENT, Progress
from limbcli.site_model.indentation_model import indentation_model, starting_depth, with_penalty
from limbcli.site_model.layer_readings import LayerReadings
from limbcli.solvers.integration_points import IntegrationPoints
from limbcli.solvers.material_lines import FILE as OF_LINES
from limbcli.solvers.material_lines import material_lines

_FILE = "displacements.csv"
_LEAST_LINE = 1e-3  # mm, smallest depth of a line below the skin
# Contact penalty as a multiple of the usual one, which was chosen for FEBio at m 2: the stiffer the tissue
# becomes, the deeper the probe penetrates it. At m 5 and a depth of 14 of 38 mm the usual penalty lowers the
# force by 22 %, four times this penalty by 10 %.
_CONTACT_STIFFER = 4.0
_MOST_CHANGE = 10.0  # largest factor on the force at fixed deformation: stretched cells, exponential laws


class SiteSimulations:
    """Curves of one site on one working mesh.

    meshed : the site's model as `mesh` makes it; depths : mm, of the levels to simulate
    reach : how far to simulate. Where the solver stops short of the depth needed, but beyond enough of it,
        curves are extrapolated along those of a stiffer law, or of the model without effects
    c : MPa, the reference stiffness; keep : cache folder; layers : whose borders to track, but for that at
        the bone
    few : of the depths, those at which models with effects are solved; n_solves : of this run, with failed
        ones
    nodes : indices of the tissue's; lines (n_borders,) : mm below the skin at first touch, of layer borders
    in_part : label of a model -> mm reached by the solver, where less than the depth `needed`
    """

    def __init__(
        self, meshed: LimbModel, depths: Sequence[float], *, c: float, f_kappa: float = 100.0,
        density_kg_per_m3: float = 1000.0, windows: Windows = Windows(), keep: Path | None = None,
        progress: Progress = SILENT, layers: LayerReadings | None = None,
        reach: Reach = Reach(), solving: Solving = Solving(),
    ):  # fmt: skip
        plan = schedule(list(depths), start=starting_depth(meshed, depths[0]))
        model = indentation_model(meshed, plan, c=c, f_kappa=f_kappa, m=2.0)
        self.lines = lines = None if layers is None else np.asarray(layers.rest[: layers.n_counted])
        self.nodes = np.unique(model.mesh.solid_blocks[0].cells)
        self.density_kg_per_m3 = density_kg_per_m3
        records = [LogRecord("node", ("ux", "uy", "uz"), _FILE, self.nodes)]
        if lines is not None:  # of all tissue nodes, as effects may move the mesh under the beam
            records.append(LogRecord("node", ("ux", "uy", "uz"), OF_LINES, model.mesh.solid_nodes))
        model = with_penalty(model, solving.penalty or _CONTACT_STIFFER * model.contacts[0].penalty)
        self.c, self.windows, self.depths = c, windows, [float(each) for each in depths]
        self.model = replace(model, records=(*model.records[:1], *records))
        self.needed = self.depths[-1] if reach.needed is None else reach.needed
        content = fingerprint(
            self.model, depths, c=c, f_kappa=f_kappa, windows=windows, enough_force=reach.enough_force,
            lines=lines, density_kg_per_m3=density_kg_per_m3,
        )  # fmt: skip
        self.models = SiteModels(usual=self.model, c=c, f_kappa=f_kappa, fingerprint=content)
        times = dict(zip(self.depths, plan.times, strict=True))
        self.solver = SiteSolver(
            self.models, times, reach=reach, solving=solving, keep=keep, progress=progress
        )
        self.work, self.n_solves = self.solver.work, 0
        self.few, self._n_full = reach.few(self.depths), reach.down_to(self.depths, share=1.0)
        self.in_part: dict[str, float] = {}
        # by m: the model without effects, its force (n,) and ln speed (n, n_parts) at its own deformation
        self._unchanged: dict[float, tuple[LimbModel, Array, Array]] = {}
        self._known: dict[str, Curves | SolveError] = {}
        self._kinematics: dict[str, SolvedDeformation] = {}

    def on_mesh(
        self, meshed: LimbModel, depths: Sequence[float], *, enough: float, penalty: float
    ) -> SiteSimulations:
        """Simulations of the same tissue on another mesh of the site, beside these, in the same cache."""
        solver = self.solver
        return SiteSimulations(
            meshed, depths, c=self.c, f_kappa=self.models.f_kappa, windows=self.windows,
            density_kg_per_m3=self.density_kg_per_m3, keep=solver.memo.folder,
            progress=solver.progress,
            reach=Reach(enough=enough, enough_force=solver.reach.enough_force),
            solving=replace(solver.solving, penalty=penalty, beside=self),
        )  # fmt: skip

    @property
    def spent(self) -> bool:
        return self.work.spent

    def close(self) -> None:
        self.solver.close()

    def curves(self, m: float, ingredients: Ingredients = ()) -> Curves:
        """The curves with exponent m and these effects (at their parameter values) in the model.

        Raises SolveError if the simulation fails; the failure is cached too.
        """
        key = self.models.key(m, ingredients)
        if key not in self._known:
            try:
                self._known[key] = self._kept(key, m, ingredients) or self._solved(key, m, ingredients)
            except SolveError as error:
                self._known[key] = error
        found = self._known[key]
        if isinstance(found, SolveError):
            raise found
        return found

    def kinematics(self, m: float) -> SolvedDeformation:
        """The tissue's deformation in the model without effects."""
        key = self.models.key(m, ())
        curves = self.curves(m)
        if key not in self._kinematics:  # the curves were cached by an earlier run
            values = self.solver.memo.read(f"{key}-nodes", lambda stored: stored["values"].astype(float))
            if values is None:
                self._known[key] = self._solved(key, m, ())
            else:
                self._kinematics[key] = self.deformation(self.model, curves.depth, values)
        return self._kinematics[key]

    def shift(self, m: float, ingredients: Ingredients) -> tuple[Array, Array]:
        """First-order change of ln force (n,) and ln speed (n, n_parts) by effects of the law, at the
        deformation solved without them; that of force at depth 0 is set to that of the first level.

        Raises SolveError if the force at fixed deformation changes by more than `_MOST_CHANGE` times.
        """
        kinematics, of_law, density = self.kinematics(m), laws(ingredients), self.density_kg_per_m3
        if m not in self._unchanged:
            plain = self.models.of(m)
            log_speed = frozen_speed(plain, kinematics, density_kg_per_m3=density)
            self._unchanged[m] = plain, frozen_force(plain, kinematics), log_speed
        plain, force, log_speed = self._unchanged[m]
        changed, in_window = (
            self.models.of(m, of_law, waves=waves) if of_law else plain for waves in (False, True)
        )
        ratio = frozen_force(changed, kinematics, stiffness_fields(ingredients))[1:] / force[1:]
        if not np.all((ratio > 1 / _MOST_CHANGE) & (ratio < _MOST_CHANGE)):
            raise SolveError(
                f"it changes the force more than {_MOST_CHANGE:g} times at fixed deformation",
                where="diagnose", fix="smaller steps",
            )  # fmt: skip
        fields = stiffness_fields(ingredients, waves=True)
        moved = frozen_speed(in_window, kinematics, fields, density_kg_per_m3=density)
        if of_law:
            kinematics.forget(changed, in_window)
        added = np.log(ratio)
        return np.concatenate([added[:1], added]), moved - log_speed

    def levels(self, m: float) -> tuple[LimbModel, Mapping[float, Array]]:
        """The model without effects, and its displacements (n_points, 3) in mm by depth, where solved."""
        self.curves(m)
        solved = self.solver.memo.levels(self.models.key(m, ()))
        states = {} if solved is None else solved.states
        times = self.solver.times
        return self.model, {depth: states[at].u for depth, at in times.items() if at in states}

    # ------------------------------------------------------------

    def _kept(self, key: str, m: float, ingredients: Ingredients) -> Curves | None:
        """Curves kept by an earlier run, which count and lead later solves as in that run."""
        found = self.solver.memo.read(key, SolvedCurves.of)
        if found is None or len(found.curves.depth) != len(self.depths) + 1:
            return None
        self.work.total += found.work
        self.solver.resume(key, ingredients)
        return self._noted(found, m, ingredients)

    def _solved(self, key: str, m: float, ingredients: Ingredients) -> Curves:
        self.n_solves += 1
        like = self._without(m) if ingredients else None
        depths = self.depths if like is None else self.few
        solve = self.solver.solve(m, ingredients, depths)
        values, seen = self._values(solve), stiffness_fields(ingredients, waves=True)
        kinematics = self.deformation(solve.model, solve.depth, values)
        curves = self._read(
            solve, kinematics, in_window=self.models.of(m, laws(ingredients), waves=True), stiffness=seen,
            without=self._plain_deformations(m) if seen else (),
        )  # fmt: skip
        rows = [self.depths.index(depth) + 1 for depth in depths[: len(values)]]
        n_reached, enough_force = rows[-1], self.solver.reach.enough_force
        is_enough = enough_force is not None and curves.force[-1] >= enough_force
        if like is not None:
            curves = filled(curves, like, [0, *rows])
        if further := self.depths[n_reached:]:
            if not ingredients and not is_enough:
                like = self._beside(m)
            curves = continued(curves, further, like=like)
        if not ingredients:
            if further:
                values = np.concatenate([values, *[values[-1:]] * len(further)])
                kinematics = self.deformation(solve.model, curves.depth, values)
            self._kinematics[key] = kinematics
            self.solver.memo.write(f"{key}-nodes", {"values": values.astype(np.float32)})
        self.solver.keep(key, ingredients, solve.result.levels)
        found = SolvedCurves(curves, solve.work, len(self.depths) if is_enough else n_reached)
        self._noted(found, m, ingredients)
        self.solver.memo.write(key, found.arrays())
        return curves

    def _noted(self, found: SolvedCurves, m: float, ingredients: Ingredients) -> Curves:
        """The curves, once their work is counted as usual (without effects), and what was not reached is
        reported (except with numerical effects)."""
        if not ingredients:
            self.work.usual.append(found.work)
        if found.n_reached < self._n_full and not is_numerical(ingredients):
            words = " and ".join(names_of(ingredients)) or "no effect"
            label, reached = f"{words}, m {m:g}", self.depths[found.n_reached - 1]
            self.in_part[label] = reached
            text = f"{label}: solved to {reached:.1f} of {self.depths[self._n_full - 1]:.1f} mm"
            self.solver.progress.event("note", text=text)
        return found.curves

    def _plain_deformations(self, m: float) -> list[tuple[float, SolvedDeformation]]:
        """Deformations without effects at `FIRST_M`, where solved, with their interpolation weights at m."""
        found = list(where_solved(self.kinematics, sorted(FIRST_M)).items())
        if len(found) < len(FIRST_M):
            return [(1.0, each) for _, each in found[:1]]
        (low, softer), (high, stiffer) = found
        share = float(np.clip((bend(m) - bend(low)) / (bend(high) - bend(low)), 0.0, 1.0))
        return [(1.0 - share, softer), (share, stiffer)]

    def _without(self, m: float) -> Curves | None:
        """Curves without effects, at the nearest of `FIRST_M`; None if they cannot be solved."""
        with self.work.aside(), contextlib.suppress(SolveError):
            return self.curves(nearest_m(FIRST_M, m))
        return None

    def _beside(self, m: float) -> Curves | None:
        """Curves along which incomplete ones without effects are extrapolated; None if there are none.

        Those of another mesh, or of a stiffer law, which stays stable to larger depths.
        """
        if self.solver.solving.beside is not None:
            return self.solver.solving.beside.curves(m)
        stiffer = min((each for each in FIRST_M if each > m), default=m)
        return None if stiffer == m else self._without(stiffer)

    # ------------------------------------------------------------ what is read of a solve

    def _values(self, solve: Solve) -> Array:
        """Displacements at the levels reached, in the memo's precision, with which a resumed run goes on."""
        return solve.result.simulation.nodes[_FILE].values[solve.result.rows].astype(np.float32).astype(float)

    def deformation(self, model: LimbModel, depth: Array, values: Array) -> SolvedDeformation:
        """The tissue's deformation at these depths (mm, n), the first of which is 0."""
        points = IntegrationPoints.of(model.mesh.points, model.mesh.solid_blocks[0])
        displacement = np.zeros((len(depth), len(model.mesh.points), 3))
        displacement[1:, self.nodes] = values
        rest = points.rest.reshape(-1, 3)
        F = np.array([points.gradients(u) for u in displacement])
        seen = [
            self.windows.seen(
                model, points.places(u).reshape(-1, 3), rest, gradient.reshape(-1, 3, 3), depth=float(d)
            )
            for u, gradient, d in zip(displacement, F, depth, strict=True)
        ]
        return SolvedDeformation(depth, F, points.rest, points.volume, tuple(seen))

    def _read(
        self, solve: Solve, kinematics: SolvedDeformation, *, in_window: LimbModel,
        stiffness: Sequence[Stiffness] = (), without: Sequence[tuple[float, SolvedDeformation]] = (),
    ) -> Curves:  # fmt: skip
        """Curves down to the level reached; in_window : the model used for the wave speeds, whose stiffnesses
        the fields `stiffness` multiply; without : see `strain_concentrations`"""
        density = self.density_kg_per_m3
        concentrations = strain_concentrations(
            in_window, kinematics, without, stiffness, density_kg_per_m3=density
        )
        speeds = frozen_speed(
            in_window, kinematics, stiffness, density_kg_per_m3=density, concentrations=concentrations
        )
        return Curves(
            kinematics.depth, np.concatenate([[0.0], solve.result.must_points.forces]), speeds,
            self.windows.depths, thickness(solve.model), self._log_lines(solve),
        )  # fmt: skip

    def _log_lines(self, solve: Solve) -> Array | None:
        """ln of the lines' depth in mm below the skin (1 + n_depths, n_borders), at rest first."""
        if self.lines is None:
            return None
        lines, moved = material_lines(solve.model, self.lines), solve.result.simulation.nodes[OF_LINES]
        below = lines.below_skin(lines.of_table(moved)[solve.result.rows][..., 2])
        return np.log(np.maximum(np.vstack([self.lines, below]), _LEAST_LINE))
