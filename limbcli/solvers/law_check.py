"""Checks recorded stresses against the model's law, to detect record files of another material.

The first loaded step is used, where a cell's mean stress is still the law's stress at the mean deformation;
only the deviatoric part, because the pressure of nearly incompressible tissue oscillates within a quadratic
cell. Only plain elastic laws with scalar parameters are checked, not element maps, mixtures, fibre or
uncoupled laws, or domains with an element rule.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from limbcli.errors import SolveError
from limbcli.materials import LAWS
from limbcli.materials.stress import cauchy_stress
from limbcli.model import Array, LimbModel, Material
from limbcli.solvers.solver import Table

_GRADIENT = ("Fxx", "Fxy", "Fxz", "Fyx", "Fyy", "Fyz", "Fzx", "Fzy", "Fzz")
_STRESS = ("sx", "sy", "sz", "sxy", "syz", "sxz")
_CELLS = 200  # number of cells compared, those with the largest deviatoric stresses
# Largest median relative difference of the stress: averaging over a tet10 cell gives 0.7 % even when it is
# deeply indented.
_TOLERANCE = 0.03
_LOADED = 0.05  # smallest stress compared, relative to the largest: in unloaded cells it is round-off
_SHEARED = 1e-3  # smallest deviatoric part of the stress: under pure pressure there is nothing to compare
_STRAIN = 0.08  # largest entry of |F - 1| of the cells compared; beyond, means over curved cells are inexact


def can_be_checked(elements: Mapping[str, Table]) -> bool:
    """Whether any table contains both deformation gradient and stress."""
    return any(_has_stress(each) for each in elements.values())


def _has_stress(table: Table) -> bool:
    return {*_GRADIENT, *_STRESS} <= set(table.fields)


def check_first_step(model: LimbModel, elements: Mapping[str, Table], folder: Path) -> None:
    """Check every table with deformation gradient and stress against its cells' laws.

    Raises SolveError if the median deviation from the law exceeds 3 %.
    """
    # the laws of the cells that can be checked, by cell number counted over all blocks
    of_block = {each.block: each for each in model.domains}
    laws: dict[int, Material] = {}
    start = 0
    for block in model.mesh.blocks:
        domain = of_block.get(block.name)
        law = model.materials[domain.material] if domain is not None else None
        if law is not None and domain is not None and domain.rule is None and _is_plain(law):
            laws.update(dict.fromkeys(range(start, start + len(block.cells)), law))
        start += len(block.cells)
    for name, table in elements.items():
        off = _deviation(table, laws) if _has_stress(table) else None
        if off is not None and off > _TOLERANCE:
            raise SolveError(
                f"the stresses in {name} do not match the model's material: "
                f"{100 * off:.0f} % off its law in the first step",
                where=str(folder / name),
                fix="run the simulation again, in a separate folder (`limbcli "
                "run`); check which program --febio names",
                deviation=off,
            )


def _is_plain(law: Material) -> bool:
    numbers = all(isinstance(each, int | float) for each in law.parameters.values())
    known = LAWS.get(law.law)
    return known is not None and not (known.fiber or known.uncoupled) and not law.parts and numbers


def _deviation(table: Table, laws: Mapping[int, Material]) -> float | None:
    """Median relative difference of the deviatoric stress where it is large; None if no cell is loaded."""
    known = np.array([int(each) in laws for each in table.items])
    loaded = np.flatnonzero(table.times > 0)
    if not known.any() or not len(loaded):
        return None
    values = table.values[loaded[0]][known]
    items = table.items[known]
    F = values[:, [table.fields.index(each) for each in _GRADIENT]].reshape(-1, 3, 3)
    whole = values[:, [table.fields.index(each) for each in _STRESS]]
    deviator = _deviator(whole)
    size = np.linalg.norm(deviator, axis=1)
    size = np.where(size > _SHEARED * np.linalg.norm(whole, axis=1), size, 0.0)
    small = (np.abs(F - np.eye(3)).max(axis=(1, 2)) < _STRAIN) & (np.linalg.det(F) > 0.2)
    most = [k for k in np.argsort(-size) if small[k] and size[k] > _LOADED * size.max() > 0][:_CELLS]
    if not most:
        return None
    stress = np.array([cauchy_stress(laws[int(items[k])], F[k][None])[0] for k in most])
    stress = stress[:, [0, 1, 2, 0, 1, 0], [0, 1, 2, 1, 2, 2]]
    expected = _deviator(stress)
    scale = np.maximum(size[most], np.linalg.norm(expected, axis=1))
    return float(np.median(np.linalg.norm(deviator[most] - expected, axis=1) / scale))


def _deviator(stress: Array) -> Array:
    """Deviatoric part (n, 6): the mean of the first three components is subtracted from them."""
    return np.concatenate([stress[:, :3] - stress[:, :3].mean(axis=1, keepdims=True), stress[:, 3:]], axis=1)
