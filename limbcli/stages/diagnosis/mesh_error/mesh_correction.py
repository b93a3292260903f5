"""From the diagnosis' coarse working mesh to what the limb would give: finer elements, and no cut.

The law is solved on the site's own mesh at a few depths, with the tissue's likely m. In force the meshes
differ alike whatever the law; in a map's pattern the difference grows with m, so that where there are maps
it is found for two m and taken between them. The cut is held in the model, and in the limb it is not: with
it held the force is too high, with it free too low, and half-way between them is what ever larger models
tend to (held at 40, 57 and 75 mm beyond the probe: a third, a half and more of the way, on three limbs).
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from limbcli.case import Site
from limbcli.effects.curves import Curves
from limbcli.errors import CaseError, LimbError, SolveError
from limbcli.feb.settings import USUAL_PENALTY
from limbcli.model import Array, LimbModel
from limbcli.results import read_result
from limbcli.stages.diagnosis.curves.curve_plan import Reach
from limbcli.stages.diagnosis.curves.exponents import bend
from limbcli.stages.diagnosis.curves.site_simulations import SiteSimulations
from limbcli.units import mpa_from_kpa

F_KAPPA, START_M = 100.0, 2.0
# Work of a solve on the site's own mesh, by that on the working mesh (and the least that counts).
_TIMES_USUAL, _LEAST_WORK = 5.0, 1000.0
_FOLLOWED = 0.2  # of the way from one m to the next: how far a correction's slope goes on beyond the last
_SHARES = (0.3, 0.6)  # of the depth needed: where the own mesh is solved


@dataclass(frozen=True, eq=False)
class MeshCorrection:
    """What is added to the working mesh's curves at `m` (n_m,), rising: ln force (n_m, n), ln speeds
    (n_m, n, n_parts); thickness ratio.

    mesh_error, speed_error : one deviation of ln force and of ln mean speed (n_levels,) at the levels
    that the mesh still leaves; map_share : of the usual error of a model's maps
    """

    m: Array
    log_force: Array
    log_speed: Array
    thickness_ratio: float
    mesh_error: Array
    speed_error: Array
    map_share: float = 1.0

    def at(self, m: float) -> Array:
        """ln force and ln speeds (n, 1 + n_parts) to be added at this m: even in `bend` between those found,
        as at the nearest beyond them, and smooth between the two, since fits follow slopes."""
        tables = np.concatenate([self.log_force[:, :, None], self.log_speed], axis=2)
        known = bend(self.m)
        place = float(np.interp(bend(m), known, np.arange(len(known))))
        if len(known) > 1:
            place += _beyond(bend(m), known[0], known[1]) - _beyond(bend(m), known[-1], known[-2])
        low = int(np.clip(int(place), 0, max(len(self.m) - 2, 0)))
        high = min(low + 1, len(self.m) - 1)
        return np.asarray(tables[low] + (place - low) * (tables[high] - tables[low]))


def _beyond(at: float, end: float, inner: float) -> float:
    """How far a line is followed beyond its end (<= 0), in units of its way to `inner`; its slope falls to 0.

    >>> [round(_beyond(at, 0.0, 1.0), 5) for at in (1.0, -0.05, -9.0)]
    [0.0, -0.04375, -0.1]
    """
    beyond = max((end - at) / (inner - end), 0.0)
    beyond = min(beyond, _FOLLOWED)
    return beyond**2 / (2 * _FOLLOWED) - beyond


@dataclass(frozen=True, eq=False)
class SiteMeshRun:
    """The site's own run at the start values: its element; depths (mm) and forces (N, at the reference c) of
    the levels that are deeper than those before."""

    element: str
    depth: Array
    force: Array


def own_curves(
    meshed: LimbModel, simulations: SiteSimulations, several: Sequence[float], *, size_ratio: float
) -> dict[float, Curves]:
    """The law with each of these m on the site's own mesh, at a few of the simulated depths; kept as those
    are. What fails after the first is left out.

    size_ratio : edges of the own mesh over the working mesh's. A penalty is taken for a facet of its size, so
    that the same penalty in proportion gives both the same contact.

    Raises
    ------
    SolveError
        If the solver gets not far enough with the first, or takes many times the work of the working mesh.
    """
    deep = np.array(simulations.depths)
    depths = sorted(
        {simulations.depths[int(np.abs(deep - share * simulations.needed).argmin())] for share in _SHARES}
    )
    own = SiteSimulations(
        meshed, depths, c=simulations.c, f_kappa=simulations.f_kappa, density_kg_per_m3=simulations.density,
        windows=simulations.windows, keep=simulations.kept.folder, progress=simulations.progress,
        reach=Reach(
            enough_force=simulations.enough_force, beside=simulations.curves, begin=simulations.levels
        ),
        solving=replace(simulations.solving, penalty=size_ratio * simulations.model.contacts[0].penalty),
    )  # fmt: skip
    own.work.at_most = _TIMES_USUAL * max(simulations.work.mean, _LEAST_WORK)
    try:
        found = {several[0]: own.curves(several[0])}
        for m in several[1:]:
            with contextlib.suppress(SolveError):
                found[m] = own.curves(m)
        return found
    finally:
        own.close()
        simulations.in_part |= {
            f"{words}, on the site's own mesh": depth for words, depth in own.in_part.items()
        }


def own_layers(site: Site, out: Path) -> str:
    """The layers that the site's own mesh has beside the tissue, in words; none where it is not meshed.

    Such layers keep a stiffness of their own, while a diagnosis takes all for one tissue: what they do to
    the force is nothing that a mesh does.
    """
    try:
        layers = read_result(out, "mesh", site=site.name).data.get("layers") or {}
    except LimbError:
        return ""
    return " and ".join(name.removesuffix("_mm") for name in layers)


def own_run(site: Site, out: Path, *, c: float) -> SiteMeshRun:
    """The site's finished run, its forces scaled to the stiffness c (MPa).

    Raises
    ------
    CaseError
        If there is none, it was made with other start values, or has layers beside the tissue.
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
    return SiteMeshRun(str(built.data.get("element")), depth[rising], force[rising] * scale)


def contact_penalty(site: Site, out: Path) -> float:
    """The penalty that the site's model was built with; the usual one where that is not known."""
    try:
        found = read_result(out, "build-feb", site=site.name).data.get("contact_penalty")
    except LimbError:
        return USUAL_PENALTY
    return float(found) if isinstance(found, int | float) else USUAL_PENALTY
