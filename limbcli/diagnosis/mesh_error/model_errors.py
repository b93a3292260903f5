"""Model errors that enter the noise of the data: mesh, maps, cut and contact, geometry."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from limbcli.case import Case, Site
from limbcli.diagnosis.curves.curve_plan import FIRST_M, where_solved
from limbcli.diagnosis.data.noise_parts import IN_MEAN, STRAIN, USUAL_THICKNESS, ModelError
from limbcli.diagnosis.mesh_error.mesh_correction import MeshCorrection
from limbcli.diagnosis.mesh_error.numerical_checks import Intervention, NumericalChecks, at_depths
from limbcli.effects.curves import Curves, gaps_filled
from limbcli.errors import LimbError
from limbcli.model import Array
from limbcli.numbers.significant_digits import short
from limbcli.results import read_result

_ALIKE = 0.8  # correlation of the mesh error between neighbouring levels
# Standard deviation of the depth at first touch: in voxel edges of imaged surfaces, and in mm of given ones.
# For comparison, a probe 53 mm long that is tilted by 1 degree touches 0.5 mm earlier.
_TOUCH_VOXELS, _TOUCH_MM = 0.5, 0.2
# Standard deviation of ln force, common to all levels, besides compressibility, cut, far side and thickness.
# At true c, m and f_kappa our force is off that of FEBio's records without noise by 4 % (root mean square,
# thirteen sites) in the first 60 % of the depth, by 7 and 13 % at strains of 0.27 and 0.35
# (`tests/benchmarks/map_errors.py`).
_GAIN = 0.07
# Relative standard deviation of the force if no fit varied an assumed geometry: as of parametric limbs.
USUAL_GAIN = 0.15
_STRAIN = 0.02  # relative standard deviation of all strains: posture, the scanner's scale of depths


class ModelErrors:
    """Model errors of one site and its simulations, at the tissue's likely m."""

    def __init__(self, numerics: NumericalChecks):
        self.numerics = numerics
        self.windows = numerics.simulations.windows
        self.curves = numerics.simulations.curves(numerics.likely_m)

    def map_slopes(self) -> Array:
        """Derivative (n_levels used, n_parts) of the model's ln speeds with depth at the levels, in 1/mm."""
        levels = self.numerics.levels
        keep = np.isfinite(levels.force) & np.isfinite(levels.depth)
        return at_depths(self.numerics.depth[keep], self.curves, _rise(self.curves)[:, 1:])

    def parts_seen(self) -> NDArray[np.bool_]:
        """Parts of the region (n_parts,) that the models without effects show at every depth.

        Others come into view under load at the edges of the face, or lie at bone: the models err more in
        them, also at the depths at which they show them.
        """
        seen = np.ones(self.windows.n_parts, dtype=bool)
        for curves in where_solved(self.numerics.simulations.curves, FIRST_M).values():
            seen &= np.isfinite(curves.log_speed[:, 1:]).all(axis=0)
        return seen

    def all(self, correction: MeshCorrection, interventions: Sequence[Intervention]) -> list[ModelError]:
        """All model errors to be included in the noise."""
        errors = [
            ModelError(f"model: {each.name}", each.left * each.log_force, each.left * each.log_speed)
            for each in interventions if each.name != "locking"
        ]  # fmt: skip
        errors += self._geometry()
        errors.append(self._error("model: mesh", force=correction.mesh_error, correlation=_ALIKE))
        return errors + self._mean_speed(correction)

    def _error(
        self, name: str, *, force: Array | float = 0.0, mean_speed: Array | float = 0.0, **more: Any
    ) -> ModelError:
        """An error of ln force and of ln mean speed at the levels, (n_levels,) or the same at all."""
        log_speed = np.zeros((len(self.numerics.levels), len(self.windows.depths)))
        log_speed[:, 0] = np.nan_to_num(mean_speed)
        return ModelError(name, np.zeros(len(log_speed)) + force, log_speed, **more)

    def _mean_speed(self, correction: MeshCorrection) -> list[ModelError]:
        """Errors of mean speeds, if there are no maps: from the mesh, and from the unknown width of the
        region."""
        if self.numerics.site.swe_maps is not None:
            return []
        curves, depth = self.curves, self.numerics.depth
        width = np.interp(depth, curves.depth, self.windows.width_uncertainty(curves.log_speed))
        mesh = np.hypot(correction.speed_error, IN_MEAN * np.nan_to_num(depth) / self.thickness)
        return [
            self._error("model: mesh, in the mean speed", mean_speed=mesh),
            self._error("model: width of the window", mean_speed=width),
        ]

    @property
    def thickness(self) -> float:
        """Tissue thickness under the probe in mm; a usual value if unknown."""
        return self.curves.thickness if self.has_bone else USUAL_THICKNESS

    @property
    def has_bone(self) -> bool:
        """Whether the beam meets bone in the model."""
        return self.curves.thickness > 0

    def _geometry(self) -> list[ModelError]:
        """Errors from the surfaces: of the depth at first touch, of the thickness and thus all strains, and
        of a common factor on the force."""
        numerics = self.numerics
        spacing = read_spacing(numerics.out)
        touch = _TOUCH_MM if spacing is None else _TOUCH_VOXELS * float(np.prod(spacing)) ** (1 / 3)
        assumed, warning = assumed_gain(numerics.case, numerics.site, numerics.out)
        if warning and warning not in numerics.notes.warnings:
            numerics.notes.warnings.append(warning)
        gain = float(np.hypot(_GAIN, assumed))
        strain = float(np.hypot(touch / self.thickness, _STRAIN))
        return [
            self._error("model: depth at first touch", depth=touch),
            self._error(STRAIN, strain=strain),
            self._error("model: gain of the force by the geometry", force=gain),
        ]


def _rise(curves: Curves) -> Array:
    """Derivative (n, 1 + n_parts) of ln speeds with depth, in 1/mm; where a part is not shown, that at the
    depths next to it."""
    shown, rise = np.isfinite(curves.log_speed), np.full(curves.log_speed.shape, np.nan)
    for k in np.flatnonzero(shown.sum(axis=0) >= 2).tolist():
        here = shown[:, k]
        rise[here, k] = np.gradient(curves.log_speed[here, k], curves.depth[here])
    return gaps_filled(rise)


def read_spacing(out: Path) -> list[float] | None:
    """Voxel spacing in mm of the image behind the surfaces; None if surfaces were given."""
    try:
        image = read_result(out, "segment").data.get("image")
    except LimbError:
        return None
    found = image.get("spacing_mm") if isinstance(image, dict) else None
    return [float(each) for each in found] if found else None


def assumed_gain(case: Case, site: Site, out: Path) -> tuple[float, str]:
    """Standard deviation of ln force from an assumed geometry, and a warning; 0 if the geometry was
    imaged."""
    words = case.imaging.assumed
    if not words:
        return 0.0, ""
    try:
        uncertainty = read_result(out, "fit", site=site.name).data.get("geometry_uncertainty") or {}
    except LimbError:
        uncertainty = {}
    found = uncertainty.get("gain_fraction")
    if uncertainty.get("words") != words or found is None:
        return USUAL_GAIN, (
            f"{words}. No fit has varied it: its uncertainty is taken as {100 * USUAL_GAIN:g} % of the force "
            f"at site {site.name}; run `limbcli fit`, then diagnose again"
        )
    return float(found), (
        f"{words}. From the fit's geometry variations, {short(100 * float(found), 2)} % of "
        f"the force at site {site.name} is uncertain, treated as one common factor; a change with depth is "
        "not allowed for"
    )
