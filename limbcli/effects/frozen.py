"""What a change of the tissue does to the force, without solving again: the deformation is kept.

Under a prescribed depth the force is dE/d(depth), E the least energy; to first order in a
change of the law E changes by the change's energy at the deformation there was (envelope
theorem). So the force's derivative with respect to every stiffness of every element, fibre
or layer follows from one solved indentation, exactly; for a finite change it is an upper bound of
the energy. Speeds follow from the law at the same deformation: their part through the
changed deformation is left out (a few per cent of the mean speed).

Source: Bonnans & Shapiro 2000, Perturbation Analysis of Optimization Problems, section 4.3.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from limbcli.effects.base import TISSUE
from limbcli.effects.waves import log_speed
from limbcli.materials import compile_material
from limbcli.materials.energy import program_energy
from limbcli.model import Array, IntArray, LimbModel


@dataclass(frozen=True, eq=False)
class Kinematics:
    """A solved indentation, cell by cell of the tissue's block.

    depth (n,) mm from 0; gradient (n, n_cells, 3, 3); volume (n_cells,) mm^3; parts: for every part
    of the scanner's window and every depth the cells in it
    """

    depth: Array
    gradient: Array
    volume: Array
    parts: tuple[tuple[IntArray, ...], ...] = ()


def energies(model: LimbModel, kinematics: Kinematics) -> Array:
    """Stored energy (n,) N mm at every depth."""
    material = compile_material(model.materials[TISSUE], TISSUE)
    program = material.program(len(kinematics.volume), lambda name: 1.0)
    ops: Any = program.ops
    total = [
        float(program_energy(ops, program.par, F[:, None])[:, 0] @ kinematics.volume)
        for F in kinematics.gradient
    ]
    return np.array(total)


def frozen_force(model: LimbModel, kinematics: Kinematics) -> Array:
    """dE/d(depth) (n,) N; 0 at depth 0 plus what a law that is stressed at rest gives."""
    curve = CubicSpline(kinematics.depth, energies(model, kinematics))
    return np.asarray(curve(kinematics.depth, 1))


def frozen_speed(model: LimbModel, kinematics: Kinematics, *, density_kg_per_m3: float) -> Array:
    """ln of the mean speed (n, n_parts) in the parts of the window, at the kept deformation."""
    rows = []
    for k, parts in enumerate(zip(*kinematics.parts, strict=True)):
        needed = np.unique(np.concatenate(parts))
        speed = np.full(len(kinematics.volume), np.nan)
        F = kinematics.gradient[k][needed]
        speed[needed] = np.exp(log_speed(model, TISSUE, F, needed, density_kg_per_m3=density_kg_per_m3))
        rows.append([float(np.log(np.nanmean(speed[part]))) if len(part) else np.nan for part in parts])
    return np.array(rows).reshape(len(kinematics.depth), -1)
