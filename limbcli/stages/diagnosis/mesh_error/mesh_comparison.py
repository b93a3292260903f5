"""How the working mesh is corrected to the site's own, and by what the site's own still errs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from limbcli.case import Site
from limbcli.effects.curves import Curves
from limbcli.errors import LimbError, SolveError
from limbcli.model import Array
from limbcli.model_io import load_model
from limbcli.progress import Progress
from limbcli.results import read_result
from limbcli.stages.diagnosis.curves.exponents import bend
from limbcli.stages.diagnosis.curves.site_simulations import SiteSimulations
from limbcli.stages.diagnosis.mesh_error.mesh_correction import MeshCorrection, own_curves, own_layers

# Quadratic elements err by the square of their edge: of the difference between two meshes, the finer keeps
# h^2 / (H^2 - h^2); taken half as much again, since neither is far in the asymptotic range.
_SAFETY = 1.5
_LEAST_ERROR, _USUAL_ERROR, _USUAL_EDGE = 0.01, 0.03, 2.5
_FREED = 0.5  # of the way from a cut that is held to one that is free: the limb
_UNCORRECTED = 1.2  # times the error that maps have where the working mesh is corrected


class ResultNotes(Protocol):
    """Where findings and warnings are noted."""

    data: dict[str, Any]
    warnings: list[str]


class MeshComparison:
    """One site's working mesh, of edges `size` mm, beside its own.

    depth : mm, of the levels (n_levels,); several : the m of the comparison, the likely one first
    """

    def __init__(
        self, site: Site, depth: Array, simulations: SiteSimulations, *, out: Path, size: float,
        several: Sequence[float], notes: ResultNotes, progress: Progress,
    ):  # fmt: skip
        self.site, self.depth, self.simulations, self.out = site, depth, simulations, out
        self.size, self.several, self.notes, self.progress = size, several, notes, progress

    def correction(self, *, solves: bool = True, freed: Mapping[float, Curves]) -> MeshCorrection:
        """To the site's own mesh, solved there (`solves`); without it, a usual error.

        freed : by m, the working mesh's curves with the cut free, as far as they are known
        """
        found = self._solved_correction() if solves else None
        if found is None:
            found = self._usual_correction(sorted(freed) or [self.several[0]])
        if not freed:
            return found
        known = np.array(sorted(freed))
        nearest = [float(known[np.abs(bend(known) - bend(m)).argmin()]) for m in found.m]
        cuts = {m: self._cut(m, freed[m]) for m in nearest}
        return replace(
            found, log_force=found.log_force + np.array([cuts[m][0] for m in nearest]),
            log_speed=found.log_speed + np.array([cuts[m][1] for m in nearest]),
        )  # fmt: skip

    def _usual_correction(self, several: Sequence[float]) -> MeshCorrection:
        """Nothing added, and the usual error."""
        nothing = np.zeros_like(self.simulations.curves(several[0]).log_speed)
        usual = np.full(len(self.depth), _USUAL_ERROR * (self.size / _USUAL_EDGE) ** 2)
        return MeshCorrection(
            np.array(several), np.array([nothing[:, 0]] * len(several)), np.array([nothing] * len(several)),
            1.0, usual, np.zeros(len(self.depth)), map_share=_UNCORRECTED,
        )  # fmt: skip

    def _cut(self, m: float, freed: Curves) -> tuple[Array, Array]:
        """What the cut's way to the limb adds to ln force (n,) and ln speeds (n, n_parts)."""
        working = self.simulations.curves(m)
        change = np.zeros(len(working.depth))
        change[1:] = np.log(np.maximum(freed.force[1:], 1e-9) / np.maximum(working.force[1:], 1e-9))
        return _FREED * change, _FREED * np.nan_to_num(freed.log_speed - working.log_speed)

    def _solved_correction(self) -> MeshCorrection | None:
        """By the law with these m on the site's own mesh; None where it is not to be had."""
        try:
            meshed = read_result(self.out, "mesh", site=self.site.name)
            if meshed.data.get("element") != "tet10":
                self.notes.warnings.append(
                    "the working mesh is not corrected to the site's own, of linear elements"
                )
                return None
            if layers := own_layers(self.site, self.out):
                self.notes.warnings.append(
                    f"the working mesh is not corrected to the site's own, which has layers ({layers}) as"
                    " well as the tissue: the diagnosis treats them as one tissue, and a layer as an effect"
                )
                return None
            model = load_model(meshed.folder / "model.npz")
        except LimbError as error:
            self.notes.warnings.append(f"the working mesh is not corrected to the site's own: {error.what}")
            return None
        h = float(meshed.data.get("size_under_probe_mm", _USUAL_EDGE))
        words = " and ".join(f"m {m:g}" for m in self.several)
        self.progress.event("note", text=f"{words} on the site's own mesh")
        try:
            found = own_curves(model, self.simulations, self.several, size_ratio=h / self.size)
        except SolveError as error:
            self.notes.warnings.append(f"the working mesh is not corrected to the site's own: {error.what}")
            return None
        apart = {m: self._apart(m, own) for m, own in found.items()}
        likely = self.several[0]
        own, working = found[likely], self.simulations.curves(likely)
        self.notes.data["working_mesh_force_ratio"] = np.exp(apart[likely][0])
        left = self._left(h)
        tables = {m: self._onward(own, *apart[m]) for m, own in found.items()}
        off = np.abs(np.interp(self.depth, working.depth, tables[likely][0]))
        in_mean = left * np.abs(np.interp(self.depth, working.depth, tables[likely][1][:, 0]))
        rising = sorted(found)
        return MeshCorrection(
            np.array(rising), np.array([tables[m][0] for m in rising]),
            np.array([tables[m][1] for m in rising]), _ratio(own.thickness, working.thickness),
            np.maximum(left * off, _LEAST_ERROR), in_mean,
        )  # fmt: skip

    def _apart(self, m: float, own: Curves) -> tuple[Array, Array]:
        """Ln force (n_own - 1,) and ln speeds (n_own, n_parts) of the own mesh over the working mesh."""
        working = self.simulations.curves(m)
        at = np.searchsorted(working.depth, own.depth - 1e-6)
        ratio = np.log(own.force[1:] / working.force[at[1:]])
        return ratio, np.nan_to_num(own.log_speed - working.log_speed[at])

    def _onward(self, own: Curves, ratio: Array, apart: Array) -> tuple[Array, Array]:
        """The same at all depths of the working mesh: (n,), (n, n_parts)."""
        depth = self.simulations.curves(self.several[0]).depth
        log_force = _onward(own.depth[1:], ratio, depth)
        log_force[0] = 0.0
        return log_force, np.array([_onward(own.depth, column, depth) for column in apart.T]).T

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
