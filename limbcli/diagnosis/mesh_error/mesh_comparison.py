"""Correction of the working mesh to the site's own mesh, and the remaining error of the latter."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from limbcli.case import Site
from limbcli.diagnosis.curves.curve_plan import bend
from limbcli.diagnosis.curves.site_simulations import SiteSimulations
from limbcli.diagnosis.mesh_error.mesh_correction import MeshCorrection, own_curves, own_layers
from limbcli.effects.curves import Curves, gaps_filled
from limbcli.errors import LimbError
from limbcli.model import Array
from limbcli.model.npz_file import load_model
from limbcli.progress import Progress
from limbcli.results import read_result

# The error of quadratic elements is proportional to the square of their edge length: the finer of two meshes
# has a remaining error of h^2 / (H^2 - h^2) times their difference. This is increased by half, since neither
# mesh is well within the asymptotic range.
_SAFETY = 1.5
# Smallest mesh error of ln force; usual one of an uncorrected mesh with edges of _USUAL_EDGE mm.
_LEAST_ERROR, _USUAL_ERROR, _USUAL_EDGE = 0.01, 0.03, 2.5
_FREED = 0.5  # position of the limb between a fixed (0) and a free (1) cut
_HELD = 0.5  # position of the limb between a free (0) and a held (1) far side, of which nothing is known
_UNCORRECTED = 1.2  # factor on the model error in maps if the working mesh is not corrected


@dataclass
class Notes:
    """Data and warnings collected while preparing a site, to be written with its results."""

    data: dict[str, Any] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)


@dataclass(frozen=True, kw_only=True)
class MeshComparison:
    """Comparison of one site's working mesh, with edges of `size` mm, with the site's own mesh.

    depth : mm, of the levels (n_levels,); several : values of m to compare, the likely one first
    """

    site: Site
    depth: Array
    simulations: SiteSimulations
    out: Path
    size: float
    several: Sequence[float]
    notes: Notes
    progress: Progress

    def correction(
        self, *, solves: bool = True, freed: Mapping[float, Curves], held: Mapping[float, Curves]
    ) -> MeshCorrection:
        """Correction to the site's own mesh by simulations there (`solves`); otherwise none, with a usual
        error.

        freed, held : by m, the working mesh's curves with the cut free, and with the far side held, as far as
        they are known
        """
        found = self._solved_correction() if solves else None
        if found is None:
            found = self._usual_correction(sorted({*freed, *held}) or [self.several[0]])
        for changed, position in ((freed, _FREED), (held, _HELD)):
            found = self._towards(found, changed, position)
        return found

    def _towards(
        self, found: MeshCorrection, changed: Mapping[float, Curves], position: float
    ) -> MeshCorrection:
        """The correction, moved by this fraction of the way to the changed curves."""
        if not changed:
            return found
        known = np.array(sorted(changed))
        nearest = [float(known[np.abs(bend(known) - bend(m)).argmin()]) for m in found.m]
        changes = [change_of(self.simulations.curves(m), changed[m]) for m in nearest]
        force, speed = (np.array(each) for each in zip(*changes, strict=True))
        return replace(
            found, log_force=found.log_force + position * force, log_speed=found.log_speed + position * speed
        )

    def _usual_correction(self, several: Sequence[float]) -> MeshCorrection:
        """Zero correction with the usual error."""
        nothing = np.zeros_like(self.simulations.curves(several[0]).log_speed)
        usual = np.full(len(self.depth), _USUAL_ERROR * (self.size / _USUAL_EDGE) ** 2)
        return MeshCorrection(
            m=np.array(several), log_force=np.array([nothing[:, 0]] * len(several)),
            log_speed=np.array([nothing] * len(several)), thickness_ratio=1.0, mesh_error=usual,
            speed_error=np.zeros(len(self.depth)), map_share=_UNCORRECTED,
        )  # fmt: skip

    def _solved_correction(self) -> MeshCorrection | None:
        """Correction from simulations with these m on the site's own mesh; None, with a warning, if
        impossible."""
        found: dict[float, Curves] = {}
        why, h = "", _USUAL_EDGE
        try:
            meshed = read_result(self.out, "mesh", site=self.site.name)
            if meshed.data.get("element") != "tet10":
                why = ", of linear elements"
            elif layers := own_layers(self.site, self.out):
                why = (
                    f", which has layers ({layers}) as well as the tissue: the diagnosis treats them as one "
                    "tissue, and a layer as an effect"
                )
            else:
                model = load_model(meshed.folder / "model.npz")
                h = float(meshed.data.get("size_under_probe_mm", _USUAL_EDGE))
                words = " and ".join(f"m {m:g}" for m in self.several)
                self.progress.event("note", text=f"{words} on the site's own mesh")
                found = own_curves(model, self.simulations, self.several, size_ratio=h / self.size)
        except LimbError as error:
            why = f": {error.what}"
        if why:
            self.notes.warnings.append(f"the working mesh is not corrected to the site's own{why}")
            return None
        apart = {m: self._apart(m, own) for m, own in found.items()}
        likely = self.several[0]
        own, working = found[likely], self.simulations.curves(likely)
        self.notes.data["working_mesh_force_ratio"] = np.exp(apart[likely][0])
        left = self._left(h)
        tables = {m: self._onward(found[m], *apart[m]) for m in sorted(found)}
        off, in_mean = (
            left * np.abs(np.interp(self.depth, working.depth, each))
            for each in (tables[likely][0], tables[likely][1][:, 0])
        )
        log_force, log_speed = (np.array(each) for each in zip(*tables.values(), strict=True))
        return MeshCorrection(
            m=np.array(sorted(found)), log_force=log_force, log_speed=log_speed,
            thickness_ratio=_ratio(own.thickness, working.thickness),
            mesh_error=np.maximum(off, _LEAST_ERROR), speed_error=in_mean,
        )  # fmt: skip

    def _apart(self, m: float, own: Curves) -> tuple[Array, Array]:
        """Difference, own minus working mesh, of ln force (n_own - 1,) and ln speeds (n_own, n_parts)."""
        working = self.simulations.curves(m)
        at = np.searchsorted(working.depth, own.depth - 1e-6)
        ratio = np.log(own.force[1:] / working.force[at[1:]])
        return ratio, gaps_filled(own.log_speed - working.log_speed[at])

    def _onward(self, own: Curves, ratio: Array, apart: Array) -> tuple[Array, Array]:
        """The same, interpolated to all depths of the working mesh: (n,), (n, n_parts)."""
        depth = self.simulations.curves(self.several[0]).depth
        log_force = _onward(own.depth[1:], ratio, depth)
        log_force[0] = 0.0
        return log_force, np.array([_onward(own.depth, column, depth) for column in apart.T]).T

    def _left(self, h: float) -> float:
        """Remaining error of the own mesh (edges of h mm), as a fraction of its difference from the working
        mesh."""
        return _SAFETY * h**2 / max(self.size**2 - h**2, h**2)


def _onward(depth: Array, values: Array, at: Array) -> Array:
    """Linear interpolation; constant before the first value, extrapolated linearly beyond the last."""
    found = np.interp(at, depth, values)
    if len(depth) > 1:
        rise = (values[-1] - values[-2]) / (depth[-1] - depth[-2])
        found = found + rise * np.maximum(at - depth[-1], 0.0)
    return np.asarray(found)


def change_of(before: Curves, after: Curves) -> tuple[Array, Array]:
    """Change of ln force (n,), 0 at depth 0, and of ln speeds (n, n_parts), between curves of the same
    depths."""
    change = np.zeros(len(before.depth))
    change[1:] = np.log(np.maximum(after.force[1:], 1e-9) / np.maximum(before.force[1:], 1e-9))
    return change, gaps_filled(after.log_speed - before.log_speed)


def at_depths(depth: Array, curves: Curves, table: Array) -> Array:
    """Interpolate a table over the curves' depths to other depths."""
    return np.array([np.interp(depth, curves.depth, column) for column in table.T]).T


def _ratio(theirs: float, ours: float) -> float:
    """Ratio of two thicknesses; 1 if either is unknown."""
    return theirs / ours if np.isfinite(theirs) and np.isfinite(ours) and ours > 0 else 1.0
