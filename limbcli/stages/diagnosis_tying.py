"""How the working mesh is tied to the site's own, and by what the site's own still errs."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Protocol

import numpy as np

from limbcli.case import Site
from limbcli.effects.reading import Curves, log_force_at
from limbcli.effects.tissue import thickness
from limbcli.errors import LimbError, SolveError
from limbcli.model import Array
from limbcli.model_io import load_model
from limbcli.progress import Progress
from limbcli.results import read_result
from limbcli.stages.diagnosis_curves import CurveBook
from limbcli.stages.diagnosis_tie import START_M, OwnRun, Tie, own_curves, own_run, speed_ratio

# Quadratic elements err by the square of their edge: of the difference between two meshes, the finer keeps
# h^2 / (H^2 - h^2); taken half as much again, since neither is far in the asymptotic range.
_SAFETY = 1.5
_LEAST_ERROR, _USUAL_ERROR, _USUAL_EDGE = 0.01, 0.03, 2.5
_OTHER_M = 2.0  # times the speeds' difference between meshes deformed as at m 2: what it leaves at another m


class Tells(Protocol):
    """Where findings and warnings are noted."""

    data: dict[str, Any]
    warnings: list[str]


class Tying:
    """One site's working mesh, of edges `size` mm, beside its own.

    depth : mm, of the levels (n_levels,); m : the tissue's likely one
    """

    def __init__(
        self, site: Site, depth: Array, book: CurveBook, *, out: Path, size: float, m: float,
        notes: Tells, progress: Progress,
    ):  # fmt: skip
        self.site, self.depth, self.book, self.out = site, depth, book, out
        self.size, self.m, self.notes, self.progress = size, m, notes, progress

    def tie(self, *, solves: bool = True) -> Tie:
        """To the site's own mesh: solved there once for the tissue's likely m (`solves`), else to its
        finished `run` (f_kappa 100, m 2); without either, a usual error."""
        if solves:
            solved = self._solved_tie()
            if solved is not None:
                return solved
        working = self.book.curves(START_M)
        try:
            own = own_run(self.site, self.out, c=self.book.c)
            if own.element == "tet10":
                return self._tied(working, own)
        except LimbError as error:
            self.notes.warnings.append(f"the working mesh is not tied to the site's own: {error.what}")
        else:
            self.notes.warnings.append(
                f"the site's own run has {own.element} elements and is not used to tie the working mesh to it"
            )
        usual = np.full(len(self.depth), _USUAL_ERROR * (self.size / _USUAL_EDGE) ** 2)
        none = np.zeros_like(working.log_speed)
        return Tie(np.zeros(len(working.depth)), none, 1.0, usual, at_depths(self.depth, working, none))

    def _solved_tie(self) -> Tie | None:
        """By the law with the likely m on the site's own mesh; None where it is not to be had."""
        try:
            meshed = read_result(self.out, "mesh", site=self.site.name)
            if meshed.data.get("element") != "tet10":
                return None
            model = load_model(meshed.folder / "model.npz")
        except LimbError:
            return None
        m, h = self.m, float(meshed.data.get("size_under_probe_mm", _USUAL_EDGE))
        self.progress.event("note", text=f"m {m:g} on the site's own mesh")
        try:
            working = self.book.curves(m)
            own = own_curves(model, self.book, m, size_ratio=h / self.size)
        except SolveError as error:
            self.progress.event("note", text=f"it stopped: {error.what}; the site's own run is used")
            return None
        depth, n = working.depth, len(own.depth)
        ratio = np.log(own.force[1:] / working.force[1:n])
        log_force = np.interp(depth, own.depth[1:], ratio)
        log_force[0] = 0.0
        apart = np.nan_to_num(own.log_speed - working.log_speed[:n])
        speeds = np.array([np.interp(depth, own.depth, column) for column in apart.T]).T
        self.notes.data["working_mesh_force_ratio"] = np.exp(ratio)
        left = self._left(h)
        off = np.abs(np.interp(self.depth, own.depth[1:], ratio))
        tall = _ratio(own.thickness, working.thickness)
        in_speeds = left * np.abs(at_depths(self.depth, working, speeds))
        return Tie(log_force, speeds, tall, np.maximum(left * off, _LEAST_ERROR), in_speeds)

    def _left(self, h: float) -> float:
        """Of what the own mesh, edges h mm, differs from the working mesh: the share it still errs by."""
        return _SAFETY * h**2 / max(self.size**2 - h**2, h**2)

    def _tied(self, working: Curves, own: OwnRun) -> Tie:
        same = self.book.curves(START_M, self.book.with_contact(own.penalty))
        ratio = np.log(np.maximum(own.force, 1e-9)) - log_force_at(same, own.depth)
        at = np.maximum(working.depth, own.depth[0])
        log_force = np.interp(at, own.depth, ratio)
        log_force[0] = 0.0
        meshed = read_result(self.out, "mesh", site=self.site.name)
        left = self._left(float(meshed.data.get("size_under_probe_mm", _USUAL_EDGE)))
        error = np.maximum(left * np.abs(np.interp(self.depth, own.depth, ratio)), _LEAST_ERROR)
        tall = _ratio(thickness(load_model(meshed.folder / "model.npz")), working.thickness)
        self.notes.data["working_mesh_force_ratio"] = np.exp(ratio)
        speeds = speed_ratio(own, self.book, self.m)
        # Deformations at the tissue's own m are more uneven than those at m 2.
        left_in_speeds = _OTHER_M * np.abs(at_depths(self.depth, working, speeds))
        return Tie(log_force, speeds, tall, error, left_in_speeds)


def at_depths(depth: Array, curves: Curves, table: Array) -> Array:
    """A table over the curves' depths, at other depths."""
    return np.array([np.interp(depth, curves.depth, column) for column in table.T]).T


def _ratio(theirs: float, ours: float) -> float:
    """Of two thicknesses; 1 where either is not known."""
    return theirs / ours if np.isfinite(theirs) and np.isfinite(ours) and ours > 0 else 1.0
