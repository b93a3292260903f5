"""How the working mesh is tied to the site's own, and by what the site's own still errs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from limbcli.case import Site
from limbcli.effects.reading import Curves
from limbcli.errors import LimbError, SolveError
from limbcli.model import Array
from limbcli.model_io import load_model
from limbcli.progress import Progress
from limbcli.results import read_result
from limbcli.stages.diagnosis_curves import CurveBook
from limbcli.stages.diagnosis_tie import Tie, own_curves

# Quadratic elements err by the square of their edge: of the difference between two meshes, the finer keeps
# h^2 / (H^2 - h^2); taken half as much again, since neither is far in the asymptotic range.
_SAFETY = 1.5
_LEAST_ERROR, _USUAL_ERROR, _USUAL_EDGE = 0.01, 0.03, 2.5
_FREED = 0.5  # of the way from a cut that is held to one that is free: the limb
_USUAL_MAP, _LEAST_SHARE, _MOST_SHARE = (
    0.07,
    0.7,
    1.5,
)  # of ln speed, a unit of strain, by which meshes differ


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

    def tie(self, *, solves: bool = True, freed: Curves | None = None) -> Tie:
        """To the site's own mesh, solved there for the likely m (`solves`); without it, a usual error.

        freed : the working mesh's curves with the cut free, at that m
        """
        working = self.book.curves(self.m)
        found = self._solved_tie(working) if solves else None
        if found is None:
            usual = np.full(len(self.depth), _USUAL_ERROR * (self.size / _USUAL_EDGE) ** 2)
            found = Tie(
                np.zeros(len(working.depth)), np.zeros_like(working.log_speed), 1.0, usual,
                np.zeros(len(self.depth)),
            )  # fmt: skip
        if freed is None:
            return found
        change = np.zeros(len(working.depth))
        change[1:] = np.log(np.maximum(freed.force[1:], 1e-9) / np.maximum(working.force[1:], 1e-9))
        speeds = np.nan_to_num(freed.log_speed - working.log_speed)
        return replace(
            found, log_force=found.log_force + _FREED * change, log_speed=found.log_speed + _FREED * speeds
        )

    def _solved_tie(self, working: Curves) -> Tie | None:
        """By the law with the likely m on the site's own mesh; None where it is not to be had."""
        try:
            meshed = read_result(self.out, "mesh", site=self.site.name)
            if meshed.data.get("element") != "tet10":
                self.notes.warnings.append(
                    "the working mesh is not tied to the site's own, of linear elements"
                )
                return None
            model = load_model(meshed.folder / "model.npz")
        except LimbError as error:
            self.notes.warnings.append(f"the working mesh is not tied to the site's own: {error.what}")
            return None
        h = float(meshed.data.get("size_under_probe_mm", _USUAL_EDGE))
        self.progress.event("note", text=f"m {self.m:g} on the site's own mesh")
        try:
            own = own_curves(model, self.book, self.m, size_ratio=h / self.size)
        except SolveError as error:
            self.notes.warnings.append(f"the working mesh is not tied to the site's own: {error.what}")
            return None
        at = np.searchsorted(working.depth, own.depth - 1e-6)
        ratio = np.log(own.force[1:] / working.force[at[1:]])
        log_force = _onward(own.depth[1:], ratio, working.depth)
        log_force[0] = 0.0
        apart = np.nan_to_num(own.log_speed - working.log_speed[at])
        speeds = np.array([_onward(own.depth, column, working.depth) for column in apart.T]).T
        self.notes.data["working_mesh_force_ratio"] = np.exp(ratio)
        left = self._left(h)
        off = np.abs(np.interp(self.depth, working.depth, log_force))
        tall = _ratio(own.thickness, working.thickness)
        in_mean = left * np.abs(np.interp(self.depth, working.depth, speeds[:, 0]))
        return Tie(
            log_force, speeds, tall, np.maximum(left * off, _LEAST_ERROR), in_mean,
            self._map_share(own, apart),
        )  # fmt: skip

    def _map_share(self, own: Curves, apart: Array) -> float:
        """By how much two meshes of this site differ in their maps, over the usual."""
        strain = own.depth[1:] / own.thickness if own.thickness > 0 else own.depth[1:] * np.nan
        inside = apart[1:, 1:] - apart[1:, 1:].mean(axis=1, keepdims=True)
        share = float(np.sqrt(np.mean((inside / strain[:, None]) ** 2))) / _USUAL_MAP
        return float(np.clip(share, _LEAST_SHARE, _MOST_SHARE)) if np.isfinite(share) else 1.0

    def _left(self, h: float) -> float:
        """Of what the own mesh, edges h mm, differs from the working mesh: the share it still errs by."""
        return _SAFETY * h**2 / max(self.size**2 - h**2, h**2)


def _onward(depth: Array, values: Array, at: Array) -> Array:
    """Straight lines between the values, as the first before them, with the last line's rise beyond them."""
    found = np.interp(at, depth, values)
    if len(depth) > 1:
        rise = (values[-1] - values[-2]) / (depth[-1] - depth[-2])
        found = found + rise * np.maximum(at - depth[-1], 0.0)
    return np.asarray(found)


def at_depths(depth: Array, curves: Curves, table: Array) -> Array:
    """A table over the curves' depths, at other depths."""
    return np.array([np.interp(depth, curves.depth, column) for column in table.T]).T


def _ratio(theirs: float, ours: float) -> float:
    """Of two thicknesses; 1 where either is not known."""
    return theirs / ours if np.isfinite(theirs) and np.isfinite(ours) and ours > 0 else 1.0
