"""Change of the force by a change of the tissue without another solve, at the deformation of a solved
indentation.

At prescribed depth the force is dE/d(depth), with E the minimum energy. To first order in a change of the
law, E changes by the change of the energy at the original deformation (envelope theorem). So one solved
indentation gives the exact derivative of the force by any stiffness of any element, fibre or layer; for a
finite change the energy so found is an upper bound. Speeds are computed from the law at the same deformation;
their change due to the changed deformation is neglected (a few per cent of the mean speed).

A factor on all stiffnesses (`Effect.stiffness`) does not need the law: energies are multiplied by it and
speeds by its square root, at the places in the unloaded tissue that each pixel averages.

Source: Bonnans & Shapiro 2000, Perturbation Analysis of Optimization Problems, section 4.3.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from limbcli.effects.stiffness_places import Places, Stiffness, cell_means
from limbcli.effects.tissue import TISSUE
from limbcli.materials import compile_material
from limbcli.materials.energy import deformation_of, energy_at
from limbcli.materials.kernel import Deformation
from limbcli.model import Array, IntArray, LimbModel
from limbcli.shear_waves.pixels import PixelAverages
from limbcli.shear_waves.speed import block_speeds

_UNIFORM = 1e-3  # range of the factor over the cells below which no slope is fitted
_LARGEST_CORRECTION = 0.7  # limit of the ln speed correction from a cell's mean factor to that at a place


@dataclass(frozen=True, eq=False)
class StrainConcentration:
    """Change of ln speed by the different strain of a region of other stiffness: a stiff one is strained
    less, so it stiffens less.

    factor : (n_points,) of the stiffness; at each point the mean over its cell, which pixels then average
    slope : derivative of ln speed by the factor, through the deformation alone
    """

    factor: Array
    slope: float


@dataclass(frozen=True, eq=False)
class ScannerView:
    """What the scanner's region shows at one depth.

    averages : from the tissue's points to pixels
    places : (n_pixels, n, 3) places in the unloaded tissue that each pixel averages, with weights (n,)
    log_means_of : from speeds at the pixels (..., n_pixels) to ln mean speeds of the whole region and its
        parts (..., 1 + n_parts)
    """

    averages: PixelAverages
    places: Places
    weight: Array
    log_means_of: Callable[[Array], Array]

    def with_fields(
        self, at_pixels: Array, stiffness: Sequence[Stiffness],
        concentration: StrainConcentration | None = None,
    ) -> Array:  # fmt: skip
        """Speeds at pixels (n_pixels,) of the law, with its stiffnesses multiplied by fields.

        concentration : of these fields, at this depth
        """
        if not stiffness:
            return at_pixels
        factor = np.asarray(math.prod(each(self.places) for each in stiffness))
        times = np.sqrt(factor)
        if concentration is not None:
            mean = np.nan_to_num(self.averages(concentration.factor), nan=1.0)
            change = concentration.slope * (factor - mean[:, None])
            times = times * np.exp(np.clip(change, -_LARGEST_CORRECTION, _LARGEST_CORRECTION))
        return np.asarray(at_pixels * (times @ self.weight))


@dataclass(eq=False)
class SolvedDeformation:
    """A solved indentation at the q integration points of each cell of the tissue's block.

    depth : (n,) mm from 0
    gradient : (n, n_cells, q, 3, 3)
    rest : (n_cells, q, 3) positions of the points in the unloaded tissue (mm)
    volume : (n_cells, q) mm^3
    seen : the scanner's view at each depth, of the points cell after cell
    """

    depth: Array
    gradient: Array
    rest: Array
    volume: Array
    seen: tuple[ScannerView, ...] = ()
    _energies: dict[LimbModel, Array] = field(default_factory=dict)
    _speeds: dict[LimbModel, Array] = field(default_factory=dict)
    _deformations: list[Deformation] = field(default_factory=list)

    @property
    def cell_of_point(self) -> IntArray:
        """Number of the cell that each point belongs to, (n_cells q,)."""
        return np.repeat(np.arange(len(self.volume)), self.volume.shape[1])

    @cached_property
    def rate(self) -> Array:
        """(n, n) 1/mm: derivatives, at the depths, of the cubic spline through values at the depths."""
        return np.asarray(CubicSpline(self.depth, np.eye(len(self.depth)))(self.depth, 1))

    def cell_energies(self, model: LimbModel) -> Array:
        """Stored energy (n, n_cells) in N mm of each cell at each depth; cached by model."""
        if model not in self._energies:
            material = compile_material(model.materials[TISSUE], TISSUE)
            program = material.program(len(self.volume), lambda name: 1.0)
            ops: Any = program.ops
            if not self._deformations:
                self._deformations.extend(map(deformation_of, self.gradient))
            with np.errstate(over="ignore", invalid="ignore"):  # an exponential law may overflow
                energies = [energy_at(ops, program.par, each) * self.volume for each in self._deformations]
                self._energies[model] = np.array([each.sum(axis=1) for each in energies])
        return self._energies[model]

    def forget(self, *models: LimbModel) -> None:
        """Remove models that are no longer needed from the cache."""
        for model in models:
            self._energies.pop(model, None)
            self._speeds.pop(model, None)

    def pixel_speeds(self, model: LimbModel, *, density_kg_per_m3: float) -> Array:
        """Speeds (n, n_pixels) in m/s at each depth; cached by model."""
        if model not in self._speeds:
            rows = []
            for k, seen in enumerate(self.seen):
                needed = np.unique(seen.averages.index)
                speed = np.full(self.volume.size, np.nan)
                speed[needed] = self.point_speeds(k, model, needed, density_kg_per_m3=density_kg_per_m3)
                rows.append(seen.averages(speed))
            self._speeds[model] = np.array(rows)
        return self._speeds[model]

    def point_speeds(
        self, depth_number: int, model: LimbModel, points: IntArray, *, density_kg_per_m3: float
    ) -> Array:
        """Speeds (n,) in m/s at some of the points, counted cell after cell, at one of the depths."""
        F = self.gradient[depth_number].reshape(-1, 3, 3)[points]
        cells = self.cell_of_point[points]
        return block_speeds(model, TISSUE, F, cells, density_kg_per_m3=density_kg_per_m3)


def frozen_force(
    model: LimbModel, kinematics: SolvedDeformation, stiffness: Sequence[Stiffness] = ()
) -> Array:
    """dE/d(depth) (n,) N; at depth 0 it is 0 plus the force of a law that is stressed at rest; NaN where the
    law overflows.

    stiffness : fields by which all of the model's stiffnesses are multiplied
    """
    energies = kinematics.cell_energies(model)
    total = energies @ _cell_factor(model, stiffness, energies.shape[1])
    if not np.isfinite(total).all():
        return np.full(len(kinematics.depth), np.nan)
    return np.asarray(kinematics.rate @ total)


def frozen_speed(
    model: LimbModel, kinematics: SolvedDeformation, stiffness: Sequence[Stiffness] = (), *,
    density_kg_per_m3: float, concentrations: Sequence[StrainConcentration] = (),
) -> Array:  # fmt: skip
    """ln of the mean speed (n, n_parts) in the parts of the window, at the unchanged deformation.

    concentrations : one per depth, where the deformation includes the fields (see `strain_concentrations`)
    """
    speeds = kinematics.pixel_speeds(model, density_kg_per_m3=density_kg_per_m3)
    each_depth: Sequence[StrainConcentration | None] = concentrations or [None] * len(speeds)
    at_pixels = [
        seen.with_fields(row, stiffness, concentration)
        for seen, row, concentration in zip(kinematics.seen, speeds, each_depth, strict=True)
    ]
    if not at_pixels:
        return np.zeros((len(kinematics.depth), 0))
    return kinematics.seen[0].log_means_of(np.array(at_pixels))


def strain_concentrations(
    model: LimbModel, kinematics: SolvedDeformation, without: Sequence[tuple[float, SolvedDeformation]],
    stiffness: Sequence[Stiffness], *, density_kg_per_m3: float,
) -> tuple[StrainConcentration, ...]:  # fmt: skip
    """Strain concentrations of fields of stiffness, at each depth of a deformation that includes them.

    Over the points that the scanner sees, the change of ln speed due to the deformation is fitted by a plane
    plus a term in the fields' factor, averaged over each cell: a regression on Eshelby's uniform strain in an
    inclusion (1957, Proc. R. Soc. A 241, 376-396).

    model : without the fields
    without : deformations without the fields on the same cells, and the weight of each; the nearest
        depth of each is compared

    Empty if none of these is on the same cells.
    """
    same = [(w, each) for w, each in without if each.volume.shape == kinematics.volume.shape]
    if not same:
        return ()
    factor = _cell_factor(model, stiffness, len(kinematics.volume))[kinematics.cell_of_point]
    rest, volume = kinematics.rest.reshape(-1, 3), kinematics.volume.ravel()
    found = []
    for k, seen in enumerate(kinematics.seen):
        points = np.unique(seen.averages.index)

        def ln_speed(deformation: SolvedDeformation, number: int, points: IntArray = points) -> Array:
            speed = deformation.point_speeds(number, model, points, density_kg_per_m3=density_kg_per_m3)
            with np.errstate(invalid="ignore", divide="ignore"):
                return np.log(speed)

        change = ln_speed(kinematics, k)
        for w, each in same:
            change = change - w * ln_speed(each, int(np.abs(each.depth - kinematics.depth[k]).argmin()))
        design = np.column_stack([np.ones(len(points)), rest[points][:, [0, 2]], factor[points] - 1.0])
        known = np.isfinite(change)
        root = np.sqrt(volume[points][known])[:, None]
        slope = 0.0
        if known.sum() > design.shape[1] and np.ptp(factor[points][known]) > _UNIFORM:
            fitted = np.linalg.lstsq(root * design[known], root[:, 0] * change[known], rcond=None)[0]
            slope = float(fitted[-1])
        found.append(StrainConcentration(factor, slope))
    return tuple(found)


def _cell_factor(model: LimbModel, stiffness: Sequence[Stiffness], n_cells: int) -> Array:
    """Mean factor (n_cells,) by which these fields together multiply the stiffnesses of each cell."""
    return np.asarray(math.prod((cell_means(model, each) for each in stiffness), start=np.ones(n_cells)))
