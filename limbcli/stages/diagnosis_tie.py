"""From the diagnosis' coarse working mesh to the site's own.

The law with the tissue's likely m is solved on the site's own mesh once. Where that is not to be done, or
fails, the site's finished `run` takes its place: both meshes then have the contact of that run, and force is
compared as it was run (f_kappa 100, m 2). Wave speeds hang on stretches to the power of m, so they are
compared for the likely m all the same, each mesh with its own deformation at m 2.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from limbcli.case import Site
from limbcli.effects.reading import Curves
from limbcli.errors import CaseError, LimbError
from limbcli.feb.settings import USUAL_PENALTY
from limbcli.model import Array, IntArray, LimbModel
from limbcli.results import read_result
from limbcli.solvers.tables import read_finished
from limbcli.stages.diagnosis_curves import CurveBook
from limbcli.stages.fit_curves import with_tissue
from limbcli.stages.fit_speeds import level_maps
from limbcli.units import mpa_from_kpa

F_KAPPA, START_M = 100.0, 2.0
# Work of a solve on the site's own mesh, by that on the working mesh (and the least that counts): two to
# three times are usual.
_TIMES_USUAL, _LEAST_WORK = 5.0, 1000.0


@dataclass(frozen=True, eq=False)
class Tie:
    """From the working mesh to the site's own: ln ratio of force (n,), speeds (n, n_parts), thickness.

    mesh_error, speed_error : one deviation of ln force (n_levels,) and ln speeds (n_levels, n_parts) at the
    levels that the mesh still leaves
    """

    log_force: Array
    log_speed: Array
    thickness_ratio: float
    mesh_error: Array
    speed_error: Array


@dataclass(frozen=True, eq=False)
class OwnRun:
    """The site's own run at the start values: its element and contact's penalty; depths (mm) and forces
    (N, at the reference c) of the levels that are deeper than those before; where the records are."""

    element: str
    penalty: float
    depth: Array
    force: Array
    times: Array
    folder: Path
    solver: str

    def log_speeds(self, book: CurveBook, m: float) -> Array:
        """ln speed (n, n_parts) of every part of the window, for the law with this m.

        Raises
        ------
        LimbError
            If the records of the run cannot be read, or hold no tissue in the window.
        """
        from limbcli.feb.read import read_feb

        feb = self.folder / "model.feb"
        simulation = read_finished(self.solver, feb)
        rows: IntArray = np.abs(simulation.times[None, :] - self.times[:, None]).argmin(axis=1)
        model = with_tissue(read_feb(feb), c=book.c, f_kappa=book.f_kappa, m=m)
        maps = level_maps(model, simulation, rows, density_kg_per_m3=book.density, window=book.windows.window)
        return np.array([book.windows.log_means(each)[0] for each in maps])


def own_curves(meshed: LimbModel, book: CurveBook, m: float, *, size_ratio: float) -> Curves:
    """The law with this m on the site's own mesh, beside the working mesh's book; kept as the book's are.

    size_ratio : edges of the own mesh over the working mesh's. A penalty is taken for a facet of its size, so
    that the same penalty in proportion gives both the same contact.

    Raises
    ------
    SolveError
        If the solver gets not far enough, or takes many times the work of the working mesh.
    """
    depths = [each for each in book.depths if each <= book.needed + 1e-9]
    own = CurveBook(
        meshed, depths, c=book.c, f_kappa=book.f_kappa, density_kg_per_m3=book.density,
        windows=book.windows, keep=book.kept.folder, progress=book.progress, threads=book.threads,
        tolerance=book.tolerance, beside=book,
        penalty=size_ratio * book.model.contacts[0].penalty,
    )  # fmt: skip
    own.work.at_most = _TIMES_USUAL * max(book.work.mean, _LEAST_WORK)
    try:
        return own.curves(m)
    finally:
        own.close()
        book.in_part |= {f"{words}, on the site's own mesh": depth for words, depth in own.in_part.items()}


def own_run(site: Site, out: Path, *, c: float) -> OwnRun:
    """The site's finished run, its forces scaled to the stiffness c (MPa).

    Raises
    ------
    CaseError
        If there is none, or it was made with other start values.
    """
    ran = read_result(out, "run", site=site.name)
    built = read_result(out, "build-feb", site=site.name)
    if built.data.get("f_kappa") != F_KAPPA or built.data.get("m") != START_M:
        raise CaseError(
            "the site's own run was made with other start values than f_kappa 100, m 2",
            where=str(ran.folder), fix="run `limbcli build-feb` and `limbcli run` without options",
        )  # fmt: skip
    table = np.loadtxt(ran.path("force_depth"), delimiter=",", skiprows=1, ndmin=2)
    time, depth, force = table[:, 0], table[:, 1], table[:, 2]
    rising = np.flatnonzero((np.diff(depth, prepend=0.0) > 1e-6) & (force > 0))
    if len(rising) < 2:
        raise CaseError(
            "the site's own run has fewer than two depths with a force", where=str(ran.folder),
            fix="run `limbcli run` again",
        )  # fmt: skip
    scale = c / mpa_from_kpa(float(built.data["c_kpa"]))
    return OwnRun(
        str(built.data.get("element")), contact_penalty(site, out), depth[rising],
        force[rising] * scale, time[rising], ran.folder, str(ran.data.get("solver")),
    )  # fmt: skip


def contact_penalty(site: Site, out: Path) -> float:
    """The penalty that the site's model was built with; the usual one where that is not known."""
    try:
        found = read_result(out, "build-feb", site=site.name).data.get("contact_penalty")
    except LimbError:
        return USUAL_PENALTY
    return float(found) if isinstance(found, int | float) else USUAL_PENALTY


def speed_ratio(own: OwnRun, book: CurveBook, m: float) -> Array:
    """ln of the speeds on the site's own mesh over those on the working mesh (n_depths, n_parts) of the book.

    0 at rest, where nothing is known, and where either mesh has no tissue; beyond the run's depths as at
    its last.
    """
    depth = book.curves(START_M).depth
    nothing = np.zeros((len(depth), len(book.windows.depths)))
    try:
        theirs = own.log_speeds(book, m)
        ours = book.log_speeds(START_M, book.with_contact(own.penalty), law_m=m)
    except LimbError as error:
        book.progress.event("note", text=f"speeds are not tied to the site's own mesh: {error.what}")
        return nothing
    if ours is None:
        return nothing
    for k in range(nothing.shape[1]):
        known = np.isfinite(theirs[:, k])
        there = np.isfinite(ours[:, k])
        if known.sum() < 2 or there.sum() < 2:
            continue
        apart = theirs[known, k] - np.interp(own.depth[known], depth[there], ours[there, k])
        nothing[:, k] = np.interp(depth, np.r_[0.0, own.depth[known]], np.r_[0.0, apart])
    return nothing
