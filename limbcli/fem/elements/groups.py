"""Groups of cells with the same kind and material, over which the element kernels run."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from limbcli.errors import MeshError, SolveError
from limbcli.fem.elements.element import reference_gradients, shape
from limbcli.fem.elements.quadrature import rule
from limbcli.fem.elements.simd_kernels import WIDTH
from limbcli.materials import Compiled, Program, compile_material
from limbcli.materials.laws import is_three_field
from limbcli.materials.program import CurveAt, jumping
from limbcli.materials.simd import LANES
from limbcli.materials.stress import tangents_at_rest
from limbcli.model import Array, Block, Curved, Domain, IntArray, LimbModel

_NO_HISTORY = np.zeros((0, 1, 6))
_RULES = {"tet10": ("TET10G8", "TET10G4"), "tet4": ("TET4G1",), "hex8": ("HEX8G8",), "penta6": ("PENTA6G6",)}


@dataclass(frozen=True, eq=False)
class Group:
    """The cells of one domain.

    first : number of its first cell, counted over all blocks in order
    grad (n_cells, n_gauss, n_nodes, 3), weight (n_cells, n_gauss) : shape gradients and integration weights
        times Jacobian in the reference configuration
    shares (n_nodes,) : weights of the nodes in the mean position of a cell's integration points
    points (n_gauss, 3) : natural coordinates of the integration points
    three_field : whether the pressure is constant in a cell (see `mean_dilatation`)
    """

    block: str
    kind: str
    first: int
    cells: IntArray
    grad: Array
    weight: Array
    material: Compiled
    shares: Array
    points: Array
    three_field: bool = False
    _cache: dict[str, Any] = field(default_factory=dict)

    def at(self, curve: CurveAt, *, scale: float = 1.0, history: Array = _NO_HISTORY) -> Operands:
        """The kernel arguments at the time for which `curve` evaluates the load curves."""
        if self.material.varies or "program" not in self._cache:
            self._cache["program"] = self.material.program(len(self.cells), curve)
        program: Program = self._cache["program"]
        grad, weight, base = self._prestrained(curve)
        operands = Operands(
            self.cells, grad, weight, program.ops, program.par, base, scale, history, *self._moduli(program)
        )
        return operands.with_mean_pressure() if self.three_field else operands

    def _moduli(self, program: Program) -> tuple[Array, Array]:
        """Lame's lambda (pressure per volume change) and mu of the complete law at F = 1, (1 or n_cells,)."""
        if self._cache.get("lame_of") is not program:
            CC = tangents_at_rest(program)
            self._cache["lame"] = (CC[:, 0, 1] + CC[:, 1, 2] + CC[:, 0, 2]) / 3.0
            self._cache["shear"] = (CC[:, 3, 3] + CC[:, 4, 4] + CC[:, 5, 5]) / 3.0
            self._cache["lame_of"] = program
        return np.asarray(self._cache["lame"]), np.asarray(self._cache["shear"])

    def mean_grad(self, grad: Array) -> Array:
        """Mean (n_cells, n_nodes, 3) over the integration points of `grad`, cached."""
        if self._cache.get("mean_of") is not grad:
            self._cache["mean_of"], self._cache["mean_grad"] = grad, grad.mean(axis=1)
        return np.asarray(self._cache["mean_grad"])

    def with_material(self, material: Compiled) -> Group:
        return replace(self, material=material, _cache={})

    def _prestrained(self, curve: CurveAt) -> tuple[Array, Array, Array]:
        if self.material.prestrain is None:
            return self.grad, self.weight, np.eye(3)
        F0, ramp = self.material.prestrain
        r = ramp.value * curve(ramp.curve) if isinstance(ramp, Curved) else float(ramp)  # type: ignore[arg-type]
        if self._cache.get("ramp") != r:
            G = (1.0 - r) * np.eye(3) + r * F0
            self._cache["ramp"] = r
            self._cache["prestrained"] = (
                np.ascontiguousarray(self.grad @ G),
                self.weight / np.linalg.det(G),
                G,
            )
        grad, weight, G = self._cache["prestrained"]
        return grad, weight, G


@dataclass(frozen=True, eq=False)
class Operands:
    """The arrays of one group, with the kernel arguments in their order.

    cells, grad, weight : as in `Group`, with the prestrain included in grad and weight
    ops, par : program of the law (see `materials.dispatch`)
    base (3, 3) : unit tensor, or prestrain gradient
    scale, history : stress is scale * S + history
    lame, shear (1 or n_cells,) : Lame's constants at F = 1
    bulk (1 or n_cells,) : bulk modulus of cells with a constant pressure; `par` then has 0 for it
    """

    cells: IntArray
    grad: Array
    weight: Array
    ops: IntArray
    par: Array
    base: Array
    scale: float
    history: Array
    lame: Array
    shear: Array
    bulk: Array | None = None

    def with_mean_pressure(self) -> Operands:
        """The same operands with the bulk modulus, an uncoupled law's first number, taken out of `par`."""
        par = self.par.copy()
        par[:, 0] = 0.0
        return replace(self, par=par, bulk=self.par[:, 0].copy())

    def complete(self) -> Operands:
        """The same operands with the law's own pressure at every integration point."""
        if self.bulk is None:
            return self
        par = self.par.copy()
        par[:, 0] = self.bulk
        return replace(self, par=par, bulk=None)

    def arguments(self) -> tuple[Any, ...]:
        return (self.cells, self.grad, self.weight, self.ops, self.par, self.base, self.scale, self.history)

    @property
    def jumps(self) -> bool:
        """Whether the stress can be discontinuous in the deformation, making its tangent unsymmetric."""
        return bool(jumping(self.ops, self.par).any())

    def sloped(self) -> Operands:
        """The same operands with the slope of stress jumps included in the tangent."""
        if not self.jumps:
            return self
        ops = self.ops.copy()
        ops[jumping(self.ops, self.par), 2] = 1
        return replace(self, ops=ops)

    def with_program(self, program: Program) -> Operands:
        """The same cells with another program (of a derivative), weighted by its factor; no history."""
        weight = self.weight if program.factor is None else self.weight * program.factor[:, None]
        return replace(self, weight=weight, ops=program.ops, par=program.par, history=_NO_HISTORY)


def make_groups(model: LimbModel) -> list[Group]:
    """One group per domain, in the order of the model's domains."""
    firsts = _first_cells(model.mesh.blocks)
    by_name = {block.name: block for block in model.mesh.blocks}
    groups = []
    for domain in model.domains:
        block = by_name.get(domain.block)
        if block is None or not block.is_solid:
            raise SolveError(
                f"domain {domain.block!r} is not a solid block",
                where="domains of the model",
                fix=f"use one of {[b.name for b in model.mesh.blocks if b.is_solid]}",
            )
        groups.append(_group(model, domain, block, firsts[block.name]))
    return groups


def _first_cells(blocks: tuple[Block, ...]) -> dict[str, int]:
    firsts, total = {}, 0
    for block in blocks:
        firsts[block.name] = total
        total += len(block.cells)
    return firsts


def _group(model: LimbModel, domain: Domain, block: Block, first: int) -> Group:
    compiled = compile_material(model.materials[domain.material], domain.material)
    points, weights = rule(_rule(domain, block))
    grad, weight = reference_gradients(model.mesh.points, block.cells, block.kind, (points, weights))
    bad = np.flatnonzero((weight <= 0).any(axis=1) | ~np.isfinite(weight).all(axis=1))
    if len(bad):
        x, y, z = model.mesh.points[block.cells[bad[0]]].mean(axis=0)
        name = f"element {model.mesh.cell_id(first + int(bad[0]))}"
        raise MeshError(
            f"{len(bad)} cells of block {block.name!r} are inverted or flat before any load",
            where=f"{name}, near ({x:.1f}, {y:.1f}, {z:.1f}) mm",
            fix="remesh, or turn the node order of these cells",
            n_cells=len(bad),
        )
    cells = np.ascontiguousarray(block.cells, dtype=np.int64)
    if weight.shape[1] > LANES or cells.shape[1] > WIDTH:  # the compiled loops would write out of bounds
        raise NotImplementedError(f"{block.kind} with {cells.shape[1]} nodes and {weight.shape[1]} points")
    shares = shape(block.kind, points)[0].mean(axis=0)
    mean = has_mean_pressure(model, domain, block)
    return Group(block.name, block.kind, first, cells, grad, weight, compiled, shares, points, mean)


def has_mean_pressure(model: LimbModel, domain: Domain, block: Block) -> bool:
    """Whether the pressure is constant in each cell of a domain, as FEBio has it (`is_three_field`)."""
    is_default = is_three_field(model.materials[domain.material].law, block.kind)
    return is_default and domain.rule != "elastic-solid"


def differs_from_pointwise(model: LimbModel) -> bool:
    """Whether a domain of the model has a pressure that is constant in each cell."""
    blocks = {block.name: block for block in model.mesh.blocks}
    return any(has_mean_pressure(model, each, blocks[each.block]) for each in model.domains)


def _rule(domain: Domain, block: Block) -> str:
    if domain.rule is None or domain.rule in ("elastic-solid", "solid"):
        return block.kind
    known = _RULES.get(block.kind, ())
    if domain.rule not in known:
        raise SolveError(
            f"the element rule {domain.rule!r} on {block.kind} cells is not supported",
            where=f"domain {block.name!r}",
            fix=f"use one of {', '.join(known)}, or run FEBio",
        )
    return "TET10G4" if domain.rule == "TET10G4" else block.kind
