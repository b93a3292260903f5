"""A working mesh's tissue, cell by cell, and what a diagnosis may take more lightly than a final run."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from limbcli.model import Array, IntArray, LimbModel, Material

BAND = 0.05  # of I4


def volumes(model: LimbModel) -> Array:
    """(n_cells,) mm^3 of the tissue's tetrahedra or hexahedra (by their corners)."""
    block = model.mesh.solid_blocks[0]
    x = model.mesh.points[block.cells]
    parts: tuple[tuple[int, int, int, int], ...] = ((0, 1, 2, 3),)
    if block.kind == "hex8":
        parts = ((0, 1, 3, 4), (1, 2, 3, 6), (1, 3, 4, 6), (1, 4, 5, 6), (3, 4, 6, 7))
    total = np.zeros(len(x))
    for a, b, c, d in parts:
        total += (
            np.abs(np.linalg.det(np.stack([x[:, b] - x[:, a], x[:, c] - x[:, a], x[:, d] - x[:, a]], axis=1)))
            / 6
        )
    return total


def first_cell(model: LimbModel) -> int:
    first = 0
    for block in model.mesh.blocks:
        if block.is_solid:
            return first
        first += len(block.cells)
    return first


def centers(model: LimbModel, cells: IntArray) -> Array:
    block = model.mesh.solid_blocks[0]
    return np.asarray(model.mesh.points[block.cells].mean(axis=1)[cells - first_cell(model)])


def softer_jumps(model: LimbModel, band: float = BAND) -> LimbModel:
    """Sheared fibres come in over a wider band of I4: solved sooner than the jump itself."""

    def soften(material: Material) -> Material:
        parts = tuple(map(soften, material.parts))
        if material.law == "fiber_exp_pow" and material.parameters.get("mu"):
            material = material.with_parameters(band=band)
        return replace(material, parts=parts) if parts else material

    return replace(model, materials={name: soften(each) for name, each in model.materials.items()})


def fewer_steps(model: LimbModel, n: int) -> LimbModel:
    """What depends on the way takes every step: so many are enough for it."""
    steps = tuple(
        replace(each, n_steps=n, step_size=each.n_steps * each.step_size / n) if each.n_steps > n else each
        for each in model.steps
    )
    return replace(model, steps=steps)
