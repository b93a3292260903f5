"""Correction of the diagnosis' coarse working mesh to the limb: finer elements, and no truncation.

The model is simulated on the site's own mesh down to the deepest level, with the tissue's likely m. The
difference in force between the meshes hardly depends on the material law; that in a map's pattern grows with
m, so that with maps it is determined at further m and interpolated. The cut ends are fixed in the model but
not in the limb: fixed ends give too high a force and free ends too low a force. Larger and larger models
converge half-way between the two (fixed at 40, 57 and 75 mm beyond the probe: a third, a half and more of the
way, on three limbs). What the far side rests on (`far_side`) is not known either.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from limbcli.case import Site
from limbcli.diagnosis.curves.curve_plan import bend, where_solved
from limbcli.diagnosis.curves.site_simulations import SiteSimulations
from limbcli.effects.curves import Curves
from limbcli.errors import CaseError, LimbError
from limbcli.feb.settings import USUAL_PENALTY
from limbcli.model import Array, LimbModel
from limbcli.numbers.units import mpa_from_kpa
from limbcli.results import read_result

F_KAPPA, START_M = 100.0, 2.0  # ratio of bulk modulus to c; exponent m of the site's own run
# Work limit of a solve on the site's own mesh, as a multiple of the mean work on the working mesh, and the
# smallest mean work assumed.
_TIMES_USUAL, _LEAST_WORK = 5.0, 1000.0
_FOLLOWED = 0.2  # range of extrapolation beyond the last m, as a fraction of the distance to the next m
_ENOUGH = 0.6  # fraction of the depth needed that the own mesh must reach


@dataclass(frozen=True, eq=False, kw_only=True)
class MeshCorrection:
    """Additive correction of the working mesh's curves at increasing `m` (n_m,): ln force (n_m, n), ln speeds
    (n_m, n, n_parts); ratio of the thicknesses.

    mesh_error, speed_error : standard deviation of the remaining mesh error of ln force and of ln mean speed
    at the levels (n_levels,); map_share : factor on the usual model error in maps
    """

    m: Array
    log_force: Array
    log_speed: Array
    thickness_ratio: float
    mesh_error: Array
    speed_error: Array
    map_share: float = 1.0

    def at(self, m: float) -> Array:
        """Correction of ln force and ln speeds (n, 1 + n_parts) at this m.

        Interpolated linearly in `bend` and nearly constant outside the known m; the transition is smooth,
        since fits use derivatives.
        """
        tables = np.concatenate([self.log_force[:, :, None], self.log_speed], axis=2)
        known = bend(self.m)
        place = float(np.interp(bend(m), known, np.arange(len(known))))
        if len(known) > 1:
            place += _beyond(bend(m), known[0], known[1]) - _beyond(bend(m), known[-1], known[-2])
        low = int(np.clip(int(place), 0, max(len(self.m) - 2, 0)))
        high = min(low + 1, len(self.m) - 1)
        return np.asarray(tables[low] + (place - low) * (tables[high] - tables[low]))


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
    """Curves for each of these m on the site's own mesh, at the depths needed but the first; cached on disk
    like those of the working mesh. Failures after the first m are left out.

    size_ratio : edge length of the own mesh over that of the working mesh. The effect of a penalty depends on
    the facet size, so that scaling the penalty by this ratio gives both meshes the same contact.

    Raises
    ------
    SolveError
        If the solver does not reach the required depth with the first m, or exceeds the work limit.
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
    """Names of the layers that the site's own mesh has in addition to the tissue; empty if it is not meshed.

    Such layers have a separate stiffness, whereas a diagnosis treats everything as one tissue: their effect
    on the force is not a mesh error.
    """
    try:
        layers = read_result(out, "mesh", site=site.name).data.get("layers") or {}
    except LimbError:
        return ""
    return " and ".join(name.removesuffix("_mm") for name in layers)


def own_run(site: Site, out: Path, *, c: float) -> tuple[str, Curves]:
    """Element type and curve, without speeds, of the site's finished run at the start values.

    The forces are scaled to the stiffness c (MPa); levels no deeper than the previous one are left out.

    Raises
    ------
    CaseError
        If there is no run, it has fewer than two depths with a force, it was made with other start values, or
        it has layers in addition to the tissue.
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


def contact_penalty(site: Site, out: Path) -> float:
    """The contact penalty of the site's model as built; the usual one if unknown."""
    try:
        found = read_result(out, "build-feb", site=site.name).data.get("contact_penalty")
    except LimbError:
        return USUAL_PENALTY
    return float(found) if isinstance(found, int | float) else USUAL_PENALTY
