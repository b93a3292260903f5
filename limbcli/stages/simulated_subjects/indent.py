"""Simulated indentation of a site's model with known tissue, for `synth` and `phantom`.

The probe moves down millimetre by millimetre until the force or the strain of the protocol is
reached. As the final depth is not known in advance, the simulation is extended in pieces, each
starting from the levels converged before.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from limbcli.errors import CaseError, SolveError
from limbcli.feb.settings import schedule
from limbcli.materials.ogden import ogden_type
from limbcli.model import Array, LimbModel
from limbcli.numbers.units import mpa_from_kpa
from limbcli.phantom.beam import skin_bone_distance
from limbcli.phantom.protocol import LoadingProtocol, TrueLevels
from limbcli.phantom.simulated import Indentation, Speed, true_levels
from limbcli.progress import SILENT, Progress
from limbcli.shear_waves.from_simulation import AT_REST, PointStates
from limbcli.shear_waves.ogden import OgdenTerms
from limbcli.shear_waves.pixels import Window
from limbcli.shear_waves.speed import block_speeds, element_speeds, wave_speed_m_per_s
from limbcli.site_model.indentation_model import PROBE, TISSUE, indentation_model
from limbcli.site_model.prestretch import in_state, skin_rise, with_nodes_moved
from limbcli.solvers.material_lines import displacements, material_lines
from limbcli.solvers.session import ReferenceSession, path_dependent
from limbcli.solvers.solver import Simulation

Change = Callable[[LimbModel], LimbModel]
FIRST_PIECE = 6.0
_DEEPEST = 40.0
_SPACING = 1.0  # mm between simulated depths; the force is interpolated by PCHIP
_STALLED = 5.0  # residual accepted where the iterations stall, as a multiple of the tolerance
_ENOUGH = 1.02  # force at which the simulation ends, as a multiple of the last level's
_LEAST_PIECE, _LARGEST_PIECE = 1.0, 7.0
_TOUCHED = 0.05  # mm, depth from first touch above which a level of a state is used


@dataclass(frozen=True)
class KnownTissue:
    """The true parameters: c = 2 mu (kPa), f_kappa = kappa' / c, m."""

    c_kpa: float = 8.0
    f_kappa: float = 80.0
    m: float = 6.0


def indent(
    press: Press, *, protocol: LoadingProtocol, window: Window = Window(), density_kg_per_m3: float = 1000.0,
    change_for_waves: Change | None = None, borders: Array | None = None,
) -> TrueLevels:  # fmt: skip
    """The true values at every level of the protocol on a meshed site.

    In a state of stretch, depths and skin-bone distance are relative to first touch in that state.

    change_for_waves : change of the model whose law gives the speeds; None: that of `press`
    borders : depths (2,) of the lower borders of skin and fat at rest, mm, to be tracked

    Raises SolveError if the simulation fails before three levels are reached; MeasurementError if a border
    does not lie in the model's tissue.
    """
    expected = skin_bone_distance(press.meshed)
    cap = min(_DEEPEST, protocol.max_strain * expected) if expected else _DEEPEST
    model, simulation = press.until(_ENOUGH * protocol.max_force, cap)
    seen = model if change_for_waves is None else press.bare(change_for_waves, simulation)
    if press.stretch is not None:
        return _levels_in_state(
            model, seen, simulation, protocol=protocol, window=window, density_kg_per_m3=density_kg_per_m3
        )
    states = PointStates.of(model, simulation)
    return true_levels(
        _indentation(model, simulation, states, borders),
        _speed_in(press.tissue, density_kg_per_m3)
        if press.change is None
        else _speed_of(seen, states, density_kg_per_m3),
        protocol=protocol,
        skin_bone=skin_bone_distance(model),
        window=window,
    )


@dataclass(frozen=True, eq=False, kw_only=True)
class Press:
    """A site's model with its tissue, whose indentation is extended in pieces.

    tolerance : relative residual (norm of the residual over that of the forces)
    change : of the loaded model, including its tissue
    stretch : elastic stretches of the tissue along and around the limb before the probe touches it; None: not
        stretched
    """

    meshed: LimbModel
    tissue: KnownTissue
    tolerance: float = 1e-6
    progress: Progress = SILENT
    change: Change | None = None
    stretch: tuple[float, float] | None = None

    def until(self, force: float, cap: float) -> tuple[LimbModel, Simulation]:
        """Extend the simulation until the force or the depth `cap` is reached.

        If a piece fails, the levels reached before are returned.
        """
        end = min(FIRST_PIECE, cap)
        model = self._loaded(end)
        # points that alternate between contact and gap, or stick and slip, may leave a larger residual
        stalled = _STALLED * self.tolerance
        session = ReferenceSession(model, progress=self.progress, tolerance=self.tolerance, stalled=stalled)
        try:
            done = session.solve(model, records=True).simulation
            while done.probe_force(PROBE)[-1] < force and end < cap:
                further = next_end(_depth(model, done), done.probe_force(PROBE), force)
                end = min(max(further, end + _LEAST_PIECE), cap)
                longer = self._loaded(end)
                try:
                    model, done = longer, session.solve(longer, records=True).simulation
                except SolveError as error:
                    depth = float(_depth(model, done)[-1])
                    self.progress.event("note", text=f"the simulation ends at {depth:.1f} mm: {error.what}")
                    break
            return model, done
        finally:
            session.close()

    def bare(self, change: Change, simulation: Simulation) -> LimbModel:
        """The model under its load with a change other than the simulated one."""
        press = replace(self, change=change)
        there = self._loaded(FIRST_PIECE)  # for the effect of its change on the probe's position
        return press._loaded(float(_depth(there, simulation)[-1]))

    def _loaded(self, end: float) -> LimbModel:
        """The model under its load down to the depth `end`.

        A depth has the same time in every piece, by which the session finds its converged state.
        """
        plan = schedule(depths_to(end, _SPACING))
        c = mpa_from_kpa(self.tissue.c_kpa)
        model = indentation_model(self.meshed, plan, c=c, f_kappa=self.tissue.f_kappa, m=self.tissue.m)
        if self.stretch is not None:
            return self._stretched(model, list(plan.depths))
        if self.change is not None:
            model = self.change(model)
        return _evenly(model, plan.times[0]) if model.has_friction else model

    def _stretched(self, model: LimbModel, depths: list[float]) -> LimbModel:
        """The model in its state: first its law is changed, then it is stretched."""
        assert self.stretch is not None
        changed = model if self.change is None else self.change(model)
        if path_dependent(changed) or not _differ_in_laws_alone(model, changed):
            raise CaseError(
                "at a site with states, only effects in the elastic law of its tissue can be hidden",
                where="--effect",
                fix="omit the effect, or simulate a site without [[site.state]]",
            )
        return in_state(changed, depths, along=self.stretch[0], around=self.stretch[1])


def _differ_in_laws_alone(model: LimbModel, changed: LimbModel) -> bool:
    """Whether the models are the same except for laws and the contact's penalty."""
    others = [each.name for each in fields(LimbModel) if each.name not in ("materials", "contacts")]
    same = all(getattr(model, name) is getattr(changed, name) for name in others)
    contacts = zip(model.contacts, changed.contacts, strict=True)
    return same and all(replace(a, penalty=b.penalty) == b for a, b in contacts)


def _evenly(model: LimbModel, size: float) -> LimbModel:
    """The model with equal steps (s): friction restarts at every step, so that a short step loses force."""
    steps = []
    for each in model.steps:
        length = each.n_steps * each.step_size
        n = max(round(length / size), 1)
        even = replace(each, n_steps=n, step_size=length / n, dt_max=None, must_points=(), dt_max_curve=None)
        steps.append(even)
    return replace(model, steps=tuple(steps))


def _levels_in_state(
    model: LimbModel, seen: LimbModel, simulation: Simulation, *, protocol: LoadingProtocol, window: Window,
    density_kg_per_m3: float,
) -> TrueLevels:  # fmt: skip
    """The true values in a state: first the stretched tissue at rest, with the probe clear of it."""
    nodes = next(iter(simulation.nodes.values()))
    displacement = np.stack([nodes.column(name)[0] for name in ("ux", "uy", "uz")], axis=1)
    rise, _ = skin_rise(model, nodes.items, displacement)
    depth = simulation.probe_depth(PROBE) + rise
    rows = np.r_[0, np.flatnonzero(depth > _TOUCHED)]
    states = PointStates.of(model, simulation)
    positions, gradients = zip(*(states.at(int(row)) for row in rows), strict=True)

    def speed(F: Array, near: NDArray[np.bool_]) -> Array:
        return element_speeds(seen, F, states.items[near], density_kg_per_m3=density_kg_per_m3)

    return true_levels(
        Indentation(
            np.r_[0.0, depth[rows[1:]]],
            np.r_[0.0, simulation.probe_force(PROBE)[rows[1:]]],
            np.stack(positions) - [0.0, 0.0, rise],  # heights are relative to first touch, as for the face
            np.stack(gradients),
        ),
        speed,
        protocol=protocol,
        skin_bone=skin_bone_distance(with_nodes_moved(model, nodes.items, displacement)),
        window=window,
    )


def _speed_in(tissue: KnownTissue, density_kg_per_m3: float) -> Speed:
    """A function for the speeds of the unchanged law, in closed form."""
    law = ogden_type(c=mpa_from_kpa(tissue.c_kpa), f_kappa=tissue.f_kappa, m=tissue.m)
    terms = OgdenTerms.of(law)
    return lambda F, _: wave_speed_m_per_s(F, terms, density_kg_per_m3=density_kg_per_m3)


def _speed_of(model: LimbModel, states: PointStates, density_kg_per_m3: float) -> Speed:
    """A function for the speeds of the changed law at the recorded elements' points."""

    def speed(F: Array, near: NDArray[np.bool_]) -> Array:
        return block_speeds(model, TISSUE, F, states.items[near], density_kg_per_m3=density_kg_per_m3)

    return speed


def next_end(depth: Array, force: Array, target: float) -> float:
    """Depth (mm) to simulate next: power-law extrapolation of the force to `target`, limited to one piece.

    >>> float(round(next_end(np.array([4.0, 5.0, 6.0]), np.array([1.6, 2.5, 3.6]), 6.4), 3))
    8.0
    """
    low, high = float(force[-2]), float(force[-1])
    if not high > low > 0:
        return float(depth[-1]) + _LARGEST_PIECE
    power = max(1.0, np.log(high / low) / np.log(depth[-1] / depth[-2]))
    piece = float(depth[-1]) * ((target / high) ** (1 / power) - 1)
    return float(depth[-1]) + min(max(piece, _LEAST_PIECE), _LARGEST_PIECE)


def depths_to(end: float, spacing: float) -> list[float]:
    """Simulated depths, closer at the start, where the contact grows fast; `end` is the last.

    >>> depths_to(3.2, 1.0)
    [0.25, 0.5, 1.0, 2.0, 3.2]
    """
    whole = [spacing * k for k in range(1, int(np.floor(end / spacing + 1e-9)) + 1)]
    found = [each for each in [spacing / 4, spacing / 2, *whole] if each < end - 0.4 * spacing]
    return [round(each, 3) for each in [*found, end]]


def _depth(model: LimbModel, simulation: Simulation) -> Array:
    """Depths (mm) of the probe's lowest point below first touch; a change may have raised its centre."""
    return simulation.probe_depth(PROBE) + float(model.info.get("depth_offset_mm", 0.0))


def _indentation(
    model: LimbModel, simulation: Simulation, states: PointStates, borders: Array | None
) -> Indentation:
    """All states, beginning with first touch (at rest), as arrays over the recorded elements' points."""
    rows = [AT_REST, *range(len(simulation.times))]
    positions, gradients = zip(*(states.at(row) for row in rows), strict=True)
    return Indentation(
        depth=np.concatenate([[0.0], _depth(model, simulation)]),
        force=np.concatenate([[0.0], simulation.probe_force(PROBE)]),
        positions=np.stack(positions),
        deformation_gradient=np.stack(gradients),
        borders=None if borders is None else _followed(model, simulation, borders),
    )


def _followed(model: LimbModel, simulation: Simulation, rest: Array) -> Array:
    """Depths of the borders below the skin (n_states, n_borders), mm; the first state is at rest."""
    lines = material_lines(model, rest)
    return np.vstack([rest, lines.below_skin(displacements(lines, simulation)[..., 2])])
