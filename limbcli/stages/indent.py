"""Indenting a site's model with known tissue, as `synth` and `phantom` do.

The probe goes down millimetre by millimetre until the force or the strain of the
protocol is reached. How deep that is, is not known before; so the simulation is
lengthened piece by piece, each piece starting from the converged levels before.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from limbcli.errors import SolveError
from limbcli.feb.settings import schedule
from limbcli.measurement.acoustoelasticity import OgdenTerms
from limbcli.measurement.swe_prediction import Window
from limbcli.model import Array, LimbModel
from limbcli.phantom.beam import skin_bone_distance
from limbcli.phantom.protocol import Protocol, TrueLevels
from limbcli.phantom.simulated import Indentation, true_levels
from limbcli.progress import SILENT, Progress
from limbcli.solvers.base import Simulation
from limbcli.solvers.reference import ReferenceSession
from limbcli.stages.build_feb import PROBE, TISSUE, indentation_model
from limbcli.units import mpa_from_kpa

FIRST_PIECE, NEXT_PIECE = 7.0, 3.0
_DEEPEST = 40.0
_ENOUGH = 1.01  # a little more than the last level's force
_GRADIENT = ("Fxx", "Fxy", "Fxz", "Fyx", "Fyy", "Fyz", "Fzx", "Fzy", "Fzz")


@dataclass(frozen=True)
class KnownTissue:
    """The truth: c = 2 mu (kPa), f_kappa = kappa' / c, m."""

    c_kpa: float = 6.0
    f_kappa: float = 80.0
    m: float = 6.0


def indent(
    model: LimbModel,
    tissue: KnownTissue,
    *,
    protocol: Protocol,
    window: Window = Window(),
    density_kg_per_m3: float = 1000.0,
    spacing: float = 1.0,
    progress: Progress = SILENT,
) -> TrueLevels:
    """What is true at every level of the protocol on a meshed site.

    spacing : mm between simulated depths; between them the force is PCHIP

    Raises
    ------
    SolveError
        If the simulation fails before three levels are reached.
    """
    skin_bone = skin_bone_distance(model)
    cap = min(_DEEPEST, protocol.max_strain * skin_bone) if skin_bone else _DEEPEST
    model, simulation = _press(model, tissue, protocol.max_force, cap, spacing, progress)
    return true_levels(
        _indentation(model, simulation),
        OgdenTerms.of(model.materials[TISSUE]),
        protocol=protocol,
        skin_bone=skin_bone,
        window=window,
        density_kg_per_m3=density_kg_per_m3,
    )


def _press(
    meshed: LimbModel, tissue: KnownTissue, force: float, cap: float, spacing: float, progress: Progress
) -> tuple[LimbModel, Simulation]:
    """Lengthen the simulation until the force or the depth `cap` is reached."""
    session: ReferenceSession | None = None
    done: tuple[LimbModel, Simulation] | None = None
    end = min(FIRST_PIECE, cap)
    try:
        while True:
            model = _loaded(meshed, tissue, depths_to(end, spacing))
            session = session or ReferenceSession(model, progress=progress)
            try:
                done = model, session.solve(model, records=True).simulation
            except SolveError as error:
                if done is None:
                    raise
                text = f"the simulation ends at {done[1].probe_depth(PROBE)[-1]:.1f} mm: {error.what}"
                progress.event("note", text=text)
                return done
            reached = float(done[1].probe_force(PROBE)[-1])
            if reached >= _ENOUGH * force or end >= cap:
                return done
            end = min(end + NEXT_PIECE, cap)
    finally:
        if session is not None:
            session.close()


def depths_to(end: float, spacing: float) -> list[float]:
    """Simulated depths: closer at the start, where contact grows fast; `end` is the last.

    >>> depths_to(3.2, 1.0)
    [0.25, 0.5, 1.0, 2.0, 3.2]
    """
    whole = [spacing * k for k in range(1, int(np.floor(end / spacing + 1e-9)) + 1)]
    found = [each for each in [spacing / 4, spacing / 2, *whole] if each < end - 0.4 * spacing]
    return [round(each, 3) for each in [*found, end]]


def _loaded(meshed: LimbModel, tissue: KnownTissue, depths: list[float]) -> LimbModel:
    """The model under its load; every piece is cut out of one and the same schedule.

    So a depth keeps its time, by which the session finds its converged state again.
    """
    plan = schedule(depths)
    c = mpa_from_kpa(tissue.c_kpa)
    return indentation_model(meshed, plan, c=c, f_kappa=tissue.f_kappa, m=tissue.m)


def _indentation(model: LimbModel, simulation: Simulation) -> Indentation:
    """States from first touch (at rest) on, as arrays over the recorded elements."""
    elements = next(iter(simulation.elements.values()))
    nodes = next(iter(simulation.nodes.values()))
    corners = _corners(model)[elements.items]
    place = np.full(len(model.mesh.points), -1)
    place[nodes.items] = np.arange(len(nodes.items))
    moved = np.stack([nodes.column(each) for each in ("ux", "uy", "uz")], axis=-1)
    rest = model.mesh.points[corners].mean(axis=1)
    positions = rest + moved[:, place[corners]].mean(axis=2)
    F = np.stack([elements.column(each) for each in _GRADIENT], axis=-1)
    F = F.reshape(*F.shape[:2], 3, 3)
    identity = np.broadcast_to(np.eye(3), (1, *F.shape[1:]))
    return Indentation(
        depth=np.concatenate([[0.0], simulation.probe_depth(PROBE)]),
        force=np.concatenate([[0.0], simulation.probe_force(PROBE)]),
        positions=np.concatenate([rest[None], positions]),
        deformation_gradient=np.concatenate([identity, F]),
    )


def _corners(model: LimbModel) -> Array:
    """The first four nodes of every cell, numbered over all blocks (shells' last one repeats)."""
    found = []
    for block in model.mesh.blocks:
        columns = np.minimum(np.arange(4), block.cells.shape[1] - 1)
        found.append(block.cells[:, columns])
    return np.asarray(np.concatenate(found))
