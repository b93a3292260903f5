"""Correction of the diagnosis' coarse working mesh to the limb: finer elements, no truncation, hard contact.

The model is simulated on the site's own mesh down to the deepest level, with the tissue's likely m. The
difference in force between the meshes hardly depends on the material law; that in a map's pattern grows with
m, so that with maps it is determined at further m and interpolated. The cut ends are fixed in the model but
not in the limb: fixed ends give too high a force and free ends too low a force. Larger and larger models
converge half-way between the two (fixed at 40, 57 and 75 mm beyond the probe: a third, a half and more of the
way, on three limbs). What the far side rests on (`far_side`) is not known either.

A gap g = p/eps of the penalty contact acts as a compliance in series with the tissue: the same force is
reached deeper by g. Two penalties determine g as a function of force. This function depends far less on the
law's exponent than the force itself does (at the same force at most 1.8 times as much at m 2 as at m 10, a
fifth over thin tissue), so that one pair of simulations, at the tissue's likely m, corrects the curves of
similar laws and of effects by a shift of their depth.

Source: series compliance of the penalty's gap; extrapolated as a geometric series (Richardson).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from limbcli.case import Site
from limbcli.diagnosis.curves.curve_plan import FIRST_M, bend, where_solved
from limbcli.diagnosis.curves.site_simulations import SiteSimulations
from limbcli.effects.crop import LIMB_POSITION
from limbcli.effects.curves import Curves, continued, depth_at, filled, gaps_filled, log_force_at
from limbcli.effects.far_side import FAR_SIDE
from limbcli.errors import CaseError, LimbError
from limbcli.model import Array, LimbModel
from limbcli.model.npz_file import load_model
from limbcli.numbers.units import mpa_from_kpa
from limbcli.results import data_if_there, read_result

if TYPE_CHECKING:
    from limbcli.diagnosis.mesh_error.numerical_checks import NumericalChecks

F_KAPPA, START_M = 100.0, 2.0  # ratio of bulk modulus to c; exponent m of the site's own run
# Work limit of a solve on the site's own mesh, as a multiple of the mean work on the working mesh, and the
# smallest mean work assumed.
_TIMES_USUAL, _LEAST_WORK = 5.0, 1000.0
_FOLLOWED = 0.2  # range of extrapolation beyond the last m, as a fraction of the distance to the next m
_ENOUGH = 0.6  # fraction of the depth needed that the own mesh must reach
# The error of quadratic elements is proportional to the square of their edge length: the finer of two meshes
# has a remaining error of h^2 / (H^2 - h^2) times their difference. This is increased by half, since neither
# mesh is well within the asymptotic range.
_SAFETY = 1.5
# Smallest mesh error of ln force; usual one of an uncorrected mesh with edges of _USUAL_EDGE mm.
_LEAST_ERROR, _USUAL_ERROR, _USUAL_EDGE = 0.01, 0.03, 2.5
_HELD = 0.5  # position of the limb between a free (0) and a held (1) far side, of which nothing is known
_UNCORRECTED = 1.2  # factor on the model error in maps if the working mesh is not corrected
# Remaining gap of the harder contact, as a fraction of the depth shift between a penalty and a quarter of it,
# and the standard deviation of this fraction. It is a third if the gap is proportional to 1/eps. Each further
# increase of the penalty by four shifted the depth by 0.33 to 0.43 of the previous shift, which extrapolates
# to 0.5 to 0.7.
_LEFT, LEFT_ERROR = 0.5, 0.15
_POWER = 0.8  # exponent of the gap in 1/eps: a quarter of the penalty triples the gap
_LEAST_STEP = 0.05  # smallest step between two depths after the shift, as a fraction of that before


@dataclass(frozen=True, eq=False, kw_only=True)
class MeshCorrection:
    """Additive correction of the working mesh's ln force and ln speeds, `logs` (n_m, n, 1 + n_parts), at
    increasing `m` (n_m,); ratio of the thicknesses; standard deviations of the mesh error left of ln force
    and ln mean speed (n_levels,); factor on the usual model error in maps."""

    m: Array
    logs: Array
    thickness_ratio: float
    mesh_error: Array
    speed_error: Array
    map_share: float = 1.0

    def at(self, m: float) -> Array:
        """Correction of ln force and ln speeds (n, 1 + n_parts), linear in `bend` and nearly constant outside
        the known m; the transition is smooth, since fits use derivatives."""
        known = bend(self.m)
        place = float(np.interp(bend(m), known, np.arange(len(known))))
        if len(known) > 1:
            place += _beyond(bend(m), known[0], known[1]) - _beyond(bend(m), known[-1], known[-2])
        low = int(np.clip(int(place), 0, max(len(self.m) - 2, 0)))
        high = min(low + 1, len(self.m) - 1)
        return np.asarray(self.logs[low] + (place - low) * (self.logs[high] - self.logs[low]))


def _beyond(at: float, end: float, inner: float) -> float:
    """Position beyond an end (<= 0) up to which a line is extrapolated, in units of the distance to `inner`.

    The slope decreases to 0 over `_FOLLOWED`.

    >>> [round(_beyond(at, 0.0, 1.0), 5) for at in (1.0, -0.05, -9.0)]
    [0.0, -0.04375, -0.1]
    """
    beyond = max((end - at) / (inner - end), 0.0)
    beyond = min(beyond, _FOLLOWED)
    return beyond**2 / (2 * _FOLLOWED) - beyond


def own_curves(
    meshed: LimbModel, simulations: SiteSimulations, several: Sequence[float], *, size_ratio: float
) -> dict[float, Curves]:
    """Curves for each of these m on the site's own mesh, at the depths needed but the first; failures after
    the first m are left out.

    size_ratio : edge length of the own mesh over that of the working mesh, by which the penalty is scaled:
        its effect depends on the facet size

    Raises SolveError if the solver does not reach the required depth with the first m, or exceeds the work
    limit.
    """
    # of half as many, the longer steps take as much work
    depths = [depth for depth in simulations.depths[1:] if depth <= simulations.needed + 1e-9]
    penalty = size_ratio * simulations.model.contacts[0].penalty
    own = simulations.on_mesh(meshed, depths, enough=_ENOUGH, penalty=penalty)
    own.work.at_most = _TIMES_USUAL * max(simulations.work.mean, _LEAST_WORK)
    try:
        return {several[0]: own.curves(several[0])} | where_solved(own.curves, several[1:])
    finally:
        own.close()
        simulations.in_part |= {
            f"{words}, on the site's own mesh": depth for words, depth in own.in_part.items()
        }


def own_layers(site: Site, out: Path) -> str:
    """Names of the layers that the site's own mesh has beside the tissue; empty if it is not meshed. Their
    stiffness is separate, where a diagnosis has one tissue: what they change is no mesh error."""
    layers = data_if_there(out, "mesh", site=site.name).get("layers") or {}
    return " and ".join(name.removesuffix("_mm") for name in layers)


def own_run(site: Site, out: Path, *, c: float) -> tuple[str, Curves]:
    """Element type and curve, without speeds, of the site's finished run, its forces scaled to the stiffness
    c (MPa); levels no deeper than the previous one are left out.

    Raises CaseError if there is no run, it has fewer than two depths with a force, other start values, or
    layers.
    """
    ran = read_result(out, "run", site=site.name)
    if layers := own_layers(site, out):
        raise CaseError(
            f"the site's own run has {layers} as well as the tissue, but the diagnosis does not",
            where=str(ran.folder), fix="mesh and run the site without layers to have the two compared",
        )  # fmt: skip
    built = read_result(out, "build-feb", site=site.name)
    if built.data.get("f_kappa") != F_KAPPA or built.data.get("m") != START_M:
        raise CaseError(
            "the site's own run was made with other start values than f_kappa 100, m 2",
            where=str(ran.folder), fix="run `limbcli build-feb` and `limbcli run` without options",
        )  # fmt: skip
    table = np.loadtxt(ran.path("force_depth"), delimiter=",", skiprows=1, ndmin=2)
    depth, force = table[:, 1], table[:, 2]
    rising = np.flatnonzero((np.diff(depth, prepend=0.0) > 1e-6) & (force > 0))
    if len(rising) < 2:
        raise CaseError(
            "the site's own run has fewer than two depths with a force", where=str(ran.folder),
            fix="run `limbcli run` again",
        )  # fmt: skip
    scale = c / mpa_from_kpa(float(built.data["c_kpa"]))
    curve = np.r_[0.0, depth[rising]], np.r_[0.0, force[rising] * scale]
    return str(built.data.get("element")), Curves(*curve, np.zeros((len(rising) + 1, 0)), np.zeros(0))


def mesh_correction(checks: NumericalChecks, *, solves: bool) -> MeshCorrection:
    """Correction to the site's own mesh, and to a limb that is not cut and rests on something, by simulations
    (`solves`) or none, with a usual error: at the likely m and, with maps, at the others of `FIRST_M`."""
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
    """The correction at these values of m, the likely one first; freed, held : by m, as far as known, the
    working mesh's curves with the cut free, and with the far side held"""
    found = _by_own_mesh(checks, several) if solves else None
    if found is None:
        found = _usual(checks, sorted({*freed, *held}) or [several[0]])
    for changed, position in ((freed, LIMB_POSITION), (held, _HELD)):
        if changed:  # this fraction of the way to the changed curves
            known = np.array(sorted(changed))
            nearest = [float(known[np.abs(bend(known) - bend(m)).argmin()]) for m in found.m]
            changes = [change_of(checks.simulations.curves(m), changed[m]) for m in nearest]
            found = replace(found, logs=found.logs + position * np.array(changes))
    return found


def _usual(checks: NumericalChecks, several: Sequence[float]) -> MeshCorrection:
    """Zero correction with the usual error."""
    n_depths, n_parts = checks.simulations.curves(several[0]).log_speed.shape
    usual = np.full(len(checks.depth), _USUAL_ERROR * (checks.size / _USUAL_EDGE) ** 2)
    return MeshCorrection(
        m=np.array(several), logs=np.zeros((len(several), n_depths, 1 + n_parts)), thickness_ratio=1.0,
        mesh_error=usual, speed_error=np.zeros(len(checks.depth)), map_share=_UNCORRECTED,
    )  # fmt: skip


def _by_own_mesh(checks: NumericalChecks, several: Sequence[float]) -> MeshCorrection | None:
    """Correction by simulations with these m on the site's own mesh; or None, with a warning."""
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
    rows = np.searchsorted(working.depth, own.depth - 1e-6).tolist()  # where the own mesh was solved
    beyond, changes = working.depth[rows[-1] + 1 :].tolist(), {}
    for m in sorted(found):
        there = simulations.curves(m)
        changes[m] = change_of(there, continued(filled(found[m], there, rows), beyond, like=there))
    checks.notes.data["working_mesh_force_ratio"] = own.force[1:] / working.force[rows[1:]]
    in_force, in_mean = (
        left_error(h, checks.size) * np.abs(np.interp(checks.depth, working.depth, column))
        for column in changes[several[0]][:, :2].T
    )
    ratio = own.thickness / working.thickness  # NaN or infinite where either is unknown
    return MeshCorrection(
        m=np.array(list(changes)), logs=np.array(list(changes.values())),
        thickness_ratio=ratio if np.isfinite(ratio) else 1.0,
        mesh_error=np.maximum(in_force, _LEAST_ERROR), speed_error=in_mean,
    )  # fmt: skip


def change_of(before: Curves, after: Curves) -> Array:
    """Change (n, 1 + n_parts) of ln force, 0 at depth 0, and ln speeds, between curves of the same depths."""
    change = np.zeros(len(before.depth))
    change[1:] = np.log(np.maximum(after.force[1:], 1e-9) / np.maximum(before.force[1:], 1e-9))
    return np.column_stack([change, gaps_filled(after.log_speed - before.log_speed)])


def left_error(h: float, size: float) -> float:
    """Remaining error of a mesh with edges of h mm, as a fraction of its difference from one with `size`."""
    return _SAFETY * h**2 / max(size**2 - h**2, h**2)


@dataclass(frozen=True, eq=False)
class Penetration:
    """Penetration depth (n,) in mm of the probe at forces (n,) in N, starting at (0, 0); proportional to the
    force beyond the last one. Forces are those at the simulations' reference stiffness."""

    force: Array
    depth: Array

    def at(self, force: Array) -> Array:
        beyond = np.maximum(force / self.force[-1], 1.0)
        return np.asarray(np.interp(force, self.force, self.depth) * beyond)

    def without(self, curves: Curves, force: Array) -> Curves:
        """The curves for a hard contact, without penetration; force (n,) in N at the reference stiffness."""
        shifted = curves.depth - self.at(force)
        steps = np.maximum(np.diff(shifted), _LEAST_STEP * np.diff(curves.depth))
        return replace(curves, depth=np.concatenate([curves.depth[:1], curves.depth[0] + np.cumsum(steps)]))

    def taken(self, curves: Curves, force: Array, depth: float, *, penalty: float) -> float:
        """Relative reduction of the force by a penalty contact compared with hard contact, at a depth in mm.

        curves : for hard contact; force (n,) : of these at the reference stiffness
        penalty : in units of the one whose gap is known
        """
        softer = replace(curves, depth=curves.depth + self.at(force) * penalty**-_POWER)
        at = np.array([depth])
        return float(1.0 - np.exp(log_force_at(softer, at) - log_force_at(curves, at))[0])


def penetration(harder: Curves, softer: Curves) -> Penetration | None:
    """Penetration of `harder`, by `softer` with a quarter of its penalty; None if that has no less force."""
    rising = np.flatnonzero((np.diff(softer.force, prepend=0.0) > 0) & (softer.depth > 0))
    if len(rising) < 2:
        return None
    force = softer.force[rising]
    further = softer.depth[rising] - depth_at(harder, force)
    if further[-1] <= 0:
        return None
    return Penetration(np.r_[0.0, force], np.r_[0.0, _LEFT * np.maximum(further, 0.0)])
