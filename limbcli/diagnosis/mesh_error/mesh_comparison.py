"""Correction of the working mesh to the site's own mesh and to a limb that is not cut, and the remaining
error."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from limbcli.diagnosis.curves.curve_plan import FIRST_M, bend, where_solved
from limbcli.diagnosis.mesh_error.mesh_correction import MeshCorrection, own_curves, own_layers
from limbcli.diagnosis.mesh_error.numerical_checks import NumericalChecks, change_of
from limbcli.effects.crop import LIMB_POSITION
from limbcli.effects.curves import Curves, continued, filled
from limbcli.effects.far_side import FAR_SIDE
from limbcli.errors import LimbError
from limbcli.model import Array
from limbcli.model.npz_file import load_model
from limbcli.results import read_result

# The error of quadratic elements is proportional to the square of their edge length: the finer of two meshes
# has a remaining error of h^2 / (H^2 - h^2) times their difference. This is increased by half, since neither
# mesh is well within the asymptotic range.
_SAFETY = 1.5
# Smallest mesh error of ln force; usual one of an uncorrected mesh with edges of _USUAL_EDGE mm.
_LEAST_ERROR, _USUAL_ERROR, _USUAL_EDGE = 0.01, 0.03, 2.5
_HELD = 0.5  # position of the limb between a free (0) and a held (1) far side, of which nothing is known
_UNCORRECTED = 1.2  # factor on the model error in maps if the working mesh is not corrected


def mesh_correction(checks: NumericalChecks, *, solves: bool) -> MeshCorrection:
    """Correction to the site's own mesh, and to a limb that is not cut and rests on something; `solves`: by
    simulations, otherwise none, with a usual error.

    At the likely m; with maps, whose difference between meshes grows with m, also at the others of `FIRST_M`
    that are solved.
    """
    several = [checks.likely_m]
    if checks.site.swe_maps is not None:
        others = [m for m in FIRST_M if m != checks.likely_m]
        several += where_solved(checks.simulations.curves, others)
    changed = {  # failures are reported when tried as interventions
        each.name: where_solved(partial(checks.curves_with, each), several)
        for each in (checks.positions() if solves else ())
    }
    freed, held = (changed.get(name, {}) for name in ("crop", FAR_SIDE.name))
    return corrected(checks, several, freed=freed, held=held, solves=solves)


def corrected(
    checks: NumericalChecks, several: Sequence[float], *, freed: Mapping[float, Curves],
    held: Mapping[float, Curves], solves: bool = True,
) -> MeshCorrection:  # fmt: skip
    """The correction at these values of m, the likely one first.

    freed, held : by m, the working mesh's curves with the cut free, and with the far side held, as far as
    they are known
    """
    found = _by_own_mesh(checks, several) if solves else None
    if found is None:
        found = _usual(checks, sorted({*freed, *held}) or [several[0]])
    for changed, position in ((freed, LIMB_POSITION), (held, _HELD)):
        if changed:  # this fraction of the way to the changed curves
            known = np.array(sorted(changed))
            nearest = [float(known[np.abs(bend(known) - bend(m)).argmin()]) for m in found.m]
            changes = [change_of(checks.simulations.curves(m), changed[m]) for m in nearest]
            force, speed = (position * np.array(each) for each in zip(*changes, strict=True))
            found = replace(found, log_force=found.log_force + force, log_speed=found.log_speed + speed)
    return found


def _usual(checks: NumericalChecks, several: Sequence[float]) -> MeshCorrection:
    """Zero correction with the usual error."""
    nothing = np.zeros_like(checks.simulations.curves(several[0]).log_speed)
    usual = np.full(len(checks.depth), _USUAL_ERROR * (checks.size / _USUAL_EDGE) ** 2)
    return MeshCorrection(
        m=np.array(several), log_force=np.array([nothing[:, 0]] * len(several)),
        log_speed=np.array([nothing] * len(several)), thickness_ratio=1.0, mesh_error=usual,
        speed_error=np.zeros(len(checks.depth)), map_share=_UNCORRECTED,
    )  # fmt: skip


def _by_own_mesh(checks: NumericalChecks, several: Sequence[float]) -> MeshCorrection | None:
    """Correction from simulations with these m on the site's own mesh; None, with a warning, if
    impossible."""
    found: dict[float, Curves] = {}
    why, h, simulations = "", _USUAL_EDGE, checks.simulations
    try:
        meshed = read_result(checks.out, "mesh", site=checks.site.name)
        if meshed.data.get("element") != "tet10":
            why = ", of linear elements"
        elif layers := own_layers(checks.site, checks.out):
            why = (
                f", which has layers ({layers}) as well as the tissue: the diagnosis treats them as one "
                "tissue, and a layer as an effect"
            )
        else:
            model = load_model(meshed.folder / "model.npz")
            h = float(meshed.data.get("size_under_probe_mm", _USUAL_EDGE))
            words = " and ".join(f"m {m:g}" for m in several)
            checks.progress.event("note", text=f"{words} on the site's own mesh")
            found = own_curves(model, simulations, several, size_ratio=h / checks.size)
    except LimbError as error:
        why = f": {error.what}"
    if why:
        checks.notes.warnings.append(f"the working mesh is not corrected to the site's own{why}")
        return None
    own, working = found[several[0]], simulations.curves(several[0])
    rows = np.searchsorted(working.depth, own.depth - 1e-6)
    tables = {m: _difference(simulations.curves(m), found[m], rows.tolist()) for m in sorted(found)}
    log_force, log_speed = (np.array(each) for each in zip(*tables.values(), strict=True))
    checks.notes.data["working_mesh_force_ratio"] = own.force[1:] / working.force[rows[1:]]
    force, speed = tables[several[0]]
    off, in_mean = (
        left_error(h, checks.size) * np.abs(np.interp(checks.depth, working.depth, each))
        for each in (force, speed[:, 0])
    )
    return MeshCorrection(
        m=np.array(sorted(found)), log_force=log_force, log_speed=log_speed,
        thickness_ratio=_ratio(own.thickness, working.thickness),
        mesh_error=np.maximum(off, _LEAST_ERROR), speed_error=in_mean,
    )  # fmt: skip


def _difference(working: Curves, own: Curves, rows: Sequence[int]) -> tuple[Array, Array]:
    """Own minus working mesh: ln force (n,) and ln speeds (n, n_parts) at the working mesh's depths, of which
    `rows` are those of the own mesh."""
    whole = continued(filled(own, working, rows), working.depth[rows[-1] + 1 :].tolist(), like=working)
    return change_of(working, whole)


def left_error(h: float, size: float) -> float:
    """Remaining error of a mesh with edges of h mm, as a fraction of its difference from one with `size`."""
    return _SAFETY * h**2 / max(size**2 - h**2, h**2)


def _ratio(theirs: float, ours: float) -> float:
    """Ratio of two thicknesses; 1 if either is unknown."""
    return theirs / ours if np.isfinite(theirs) and np.isfinite(ours) and ours > 0 else 1.0
