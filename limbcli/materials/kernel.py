"""Interface between laws and solver: a law's kernel is a compiled function that adds its stress.

The element loops are compiled without the laws. They call a law's kernel by the address of its machine code,
one for each leaf of a program, so that a law need not be known to the loops and is compiled on first use.
Only Ogden's unconstrained law, the tissue's, is compiled into the loops: its number is OGDEN.

A kernel is `add(par, off, extra, J, work, S, CC, tangent)`, compiled by numba, in double precision:

- par : one row of numbers; those of the law start at `off`
- extra : the integer in the law's row: the number of terms, or which derivative
- J, work : det F, positive, and the workspace, with C = F'F (6)
- S (6), CC (6, 6) : second Piola-Kirchhoff stress and dS/dE in the order xx yy zz xy yz xz, MPa, to which
  the law's contribution is added; CC only if `tangent`

The workspace is (six (3, 6), three (4, 3), vectors (3, 3), matrix (3, 3)). `six[0]` is C and must not be
changed; `six[1]`, `six[2]`, `three[2]`, `three[3]` and `matrix` are free. `principal.principal_axes(work)`
sets `three[0]`, `three[1]` and `vectors`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from limbcli.numbers.compiled import njit

OGDEN = 1  # number of the law compiled into the loops; every other number is an address

_ROW, _MATRIX = types.Array(types.float64, 1, "C"), types.Array(types.float64, 2, "C")
_ARGUMENTS = (
    _ROW, types.int64, types.int64, types.float64, types.UniTuple(_MATRIX, 4), _ROW, _MATRIX, types.boolean,
)  # fmt: skip


@dataclass(frozen=True)
class Deformation:
    """C (n_cells, n_gauss, 3, 3), its principal values (.., 3) and J = det F (..).

    Complex in complex-step differentiation.
    """

    C: Any
    squares: Any
    J: Any


Energy = Callable[[Any, int, Deformation], Any]


@dataclass(frozen=True, eq=False)
class Kernel:
    """The kernel of a law, or of its derivative.

    add : the numba function described in the module docstring
    energy : (numbers (n_cells, n_numbers, 1), extra, deformation) -> density (n_cells, n_gauss), MPa; None
        for a derivative
    jump : index of the number that, if not 0, makes the stress discontinuous in the deformation. With `extra`
        1 such a kernel adds the slope of the jump to its tangent, which is then not symmetric.
    known_number : number of a kernel compiled into the loops
    works : whether its energy is work done by a muscle, not energy stored in the tissue
    """

    add: Any
    energy: Energy | None = None
    jump: int | None = None
    known_number: int | None = None
    works: bool = False

    @cached_property
    def number(self) -> int:
        """The kernel's number in a program; valid in this process only."""
        number = self.known_number
        if number is None:
            self.add.compile(_ARGUMENTS)
            made = self.add.overloads[_ARGUMENTS]
            number = int(made.library.get_pointer_to_function(made.fndesc.mangled_name))
        _KERNELS[number] = self
        return number


_KERNELS: dict[int, Kernel] = {}


def kernel_of(number: int) -> Kernel:
    """The kernel with a given number in this process's programs."""
    return _KERNELS[int(number)]


@njit
def workspace():
    """Workspace of a kernel: C and two more (6 each); squares, logs, tau, d (3 each); vectors; a (3, 3)."""
    return np.zeros((3, 6)), np.zeros((4, 3)), np.zeros((3, 3)), np.zeros((3, 3))


@intrinsic
def call_kernel(typingctx, number, par, off, extra, J, work, S, CC, tangent):  # type: ignore[no-untyped-def]
    """Call the kernel whose machine code is at address `number`; its exceptions are propagated."""
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
