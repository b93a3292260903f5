"""What a law is to the solver: a compiled function that adds to the stress, and the energy it belongs to.

The element loops are compiled without the laws. They are given a law's kernel as the address of its machine
code, one for each leaf of a program, so that a law needs no place in them, and is compiled when it is first
used. Ogden's unconstrained law alone, the tissue's, is compiled into the loops: its number is OGDEN.

A kernel is `add(par, off, extra, J, work, S, CC, tangent)`, compiled by numba, in doubles throughout:

- par : one row of numbers; the law's own begin at `off`
- extra : the integer of the law's row: a count of terms, or which derivative
- J, work : det F, positive, and the workspace, with C = F'F (6)
- S (6), CC (6, 6) : second Piola-Kirchhoff stress and dS/dE in the order xx yy zz xy yz xz, MPa, to be
  added to; CC where `tangent` says so

The workspace is (six (3, 6), three (4, 3), vectors (3, 3), matrix (3, 3)). `six[0]` is C and must be left as
it is; `six[1]`, `six[2]`, `three[2]`, `three[3]` and `matrix` are free. `principal.principal_axes(work)` sets
`three[0]`, `three[1]` and `vectors`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.core import cgutils
from numba.extending import intrinsic

OGDEN = 1  # the number of the law that the loops know; every other number is an address

_ROW, _MATRIX = types.Array(types.float64, 1, "C"), types.Array(types.float64, 2, "C")
_ARGUMENTS = (
    _ROW, types.int64, types.int64, types.float64, types.UniTuple(_MATRIX, 4), _ROW, _MATRIX, types.boolean,
)  # fmt: skip


@dataclass(frozen=True)
class Deformation:
    """C (n_cells, n_gauss, 3, 3), its principal squares (.., 3) and J = det F (..); complex for a step."""

    C: Any
    squares: Any
    J: Any


Energy = Callable[[Any, int, Deformation], Any]


@dataclass(frozen=True, eq=False)
class Kernel:
    """A law's kernel, or the derivative of one.

    add : see above; it is compiled for `par` and the like as they are there
    energy : (numbers (n_cells, n_numbers, 1), extra, deformation) -> density (n_cells, n_gauss), MPa; None
        for a derivative
    jump : which of its numbers makes the stress jump with the deformation, where it is not 0. With `extra` 1
        such a kernel adds the slope of the jump to its tangent, which is then not symmetric.
    known_number : of the one that the loops know
    works : its energy is work that a muscle does, not stored in the tissue
    """

    add: Any
    energy: Energy | None = None
    jump: int | None = None
    known_number: int | None = None
    works: bool = False

    @cached_property
    def number(self) -> int:
        """What stands for the kernel in a program, in this process."""
        number = self.known_number
        if number is None:
            self.add.compile(_ARGUMENTS)
            made = self.add.overloads[_ARGUMENTS]
            number = int(made.library.get_pointer_to_function(made.fndesc.mangled_name))
        _KERNELS[number] = self
        return number


_KERNELS: dict[int, Kernel] = {}


def kernel_of(number: int) -> Kernel:
    """The kernel behind a number of a program of this process."""
    return _KERNELS[int(number)]


@njit(cache=True)
def workspace():
    """C and two more (6 each); squares, logs, tau, d (3 each); vectors, a."""
    return np.zeros((3, 6)), np.zeros((4, 3)), np.zeros((3, 3)), np.zeros((3, 3))


@intrinsic
def call_kernel(typingctx, number, par, off, extra, J, work, S, CC, tangent):  # type: ignore[no-untyped-def]
    """Call the kernel whose machine code is at `number`; what it raises is raised here."""
    given = (par, off, extra, J, work, S, CC, tangent)
    arrays = [(par, 1), (S, 1), (CC, 2)]
    if not all(isinstance(a, types.Array) and (a.ndim, a.layout) == (n, "C") for a, n in arrays):
        raise TypeError(f"a law's kernel takes contiguous rows, not {given}")
    taken = [g if isinstance(g, types.Array) else a for g, a in zip(given, _ARGUMENTS, strict=True)]

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        convention = context.call_conv
        function = convention.get_function_type(types.none, _ARGUMENTS)
        place = builder.inttoptr(args[0], ir.PointerType(function))
        status, _ = convention.call_function(builder, place, types.none, _ARGUMENTS, args[1:])
        with cgutils.if_unlikely(builder, status.is_error):
            convention.return_status_propagate(builder, status)
        return context.get_dummy_value()

    return types.void(types.int64, *taken), codegen
