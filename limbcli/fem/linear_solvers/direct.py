"""Direct solvers for symmetric matrices behind one small interface.

Our own is in `multifrontal`. `Pardiso` (Intel MKL, through pypardiso's library handle) and `SuperLU` (scipy)
are provided for comparison. All take the upper triangle as a fixed CSR pattern, analysed once, and new values
at each `factor`.
"""

from __future__ import annotations

import ctypes
import os
import sys
from typing import Any, Protocol

import numpy as np
import scipy.sparse as sparse

from limbcli.errors import ToolError
from limbcli.fem.linear_solvers.singular import singular
from limbcli.model import Array, IntArray


class LinearSolver(Protocol):
    """Interface: factor(values), then solve(rhs); counts factorisations."""

    name: str
    n_factorisations: int

    @property
    def solves_per_factor(self) -> float: ...

    @property
    def n_perturbed(self) -> int: ...

    def factor(self, values: Array) -> None: ...

    def solve(self, rhs: Array) -> Array: ...

    def close(self) -> None: ...


def check_supported(solver: LinearSolver) -> None:
    """Raise SingularMatrix if the last factor, of unloaded tissue, has perturbed (zero) pivots."""
    if solver.n_perturbed:
        raise singular(f"{solver.n_perturbed} zero pivots before any load")


class Pardiso:
    """MKL Pardiso for a symmetric indefinite matrix, analysed once.

    single : factor in single precision (half the memory and memory traffic); the caller
        must then refine the solution iteratively.
    """

    def __init__(self, indptr: IntArray, indices: IntArray, *, threads: int = 2, single: bool = False):
        self._mkl = _mkl()
        self._mkl.MKL_Set_Num_Threads(ctypes.c_int(threads))
        self.name = "MKL Pardiso" + (" (single precision)" if single else "")
        self.n = len(indptr) - 1
        self._ia = (np.asarray(indptr) + 1).astype(np.int32)
        self._ja = (np.asarray(indices) + 1).astype(np.int32)
        self._type = np.float32 if single else np.float64
        self._values = np.ones(len(indices), dtype=self._type)
        self._pt = np.zeros(64, dtype=np.int64)
        self._iparm = np.zeros(64, dtype=np.int32)
        self._iparm[0] = 1  # do not use default settings
        self._iparm[1] = 3 if threads > 1 else 2  # nested dissection
        self._iparm[9] = 8  # pivot perturbation 1e-8
        self._iparm[20] = 1  # Bunch-Kaufman pivoting
        self._iparm[23] = 1 if threads > 1 else 0  # two-level factorisation
        self._iparm[27] = 1 if single else 0
        self._mtype = -2
        self.n_factorisations = 0
        self._call(11)

    def factor(self, values: Array) -> None:
        self._values = np.ascontiguousarray(values, dtype=self._type)
        self._call(22)
        self.n_factorisations += 1

    def solve(self, rhs: Array) -> Array:
        return self._call(33, rhs).astype(float).reshape(rhs.shape, order="F")

    @property
    def n_perturbed(self) -> int:
        """Number of perturbed pivots in the last factor."""
        return int(self._iparm[13])

    @property
    def solves_per_factor(self) -> float:
        """Cost of a factorisation in solves, fitted to limb models of 14,000 to 49,000 equations.

        A formula rather than a measured time, so that a model is always solved in the same way.
        """
        return 12.0 + self.n / 3000.0

    def close(self) -> None:
        if self._pt.any():
            self._call(-1)
            self._pt[:] = 0

    def __del__(self) -> None:
        if not sys.is_finalizing() and getattr(self, "_pt", None) is not None and self._pt.any():
            self.close()

    def _call(self, phase: int, rhs: Array | None = None) -> Array:
        b = np.zeros(self.n if phase == 33 else 1, dtype=self._type)
        if rhs is not None:
            b = np.asfortranarray(rhs, dtype=self._type)
        x = np.empty_like(b)
        columns = b.size // b.shape[0]
        number = ctypes.c_int32
        error = number(0)
        self._mkl.pardiso(
            self._pt.ctypes.data_as(ctypes.POINTER(ctypes.c_int64)),
            *(ctypes.byref(number(k)) for k in (1, 1, self._mtype, phase, self.n)),
            self._values.ctypes.data_as(ctypes.c_void_p),
            self._ia.ctypes.data_as(ctypes.POINTER(number)),
            self._ja.ctypes.data_as(ctypes.POINTER(number)),
            np.zeros(1, dtype=np.int32).ctypes.data_as(ctypes.POINTER(number)),
            ctypes.byref(number(columns)),
            self._iparm.ctypes.data_as(ctypes.POINTER(number)),
            ctypes.byref(number(0)),
            b.ctypes.data_as(ctypes.c_void_p),
            x.ctypes.data_as(ctypes.c_void_p),
            ctypes.byref(error),
        )
        if error.value == -2:
            raise ToolError(
                "not enough memory to factor the stiffness matrix",
                where=f"Pardiso, {self.n} equations",
                fix="use a coarser mesh, or tet4",
            )
        if error.value != 0 and phase > 0:
            raise singular(f"Pardiso error {error.value}")
        if phase == 33 and not np.isfinite(x).all():
            raise singular("the solution is not finite")
        return x


class SuperLU:
    """scipy's SuperLU, for machines without MKL: slower, same results."""

    def __init__(self, indptr: IntArray, indices: IntArray, *, threads: int = 2, single: bool = False):
        self.name = "SuperLU (scipy)"
        self.n = len(indptr) - 1
        self._indptr, self._indices = indptr, indices
        self._lu: Any = None
        self.n_factorisations = 0

    def factor(self, values: Array) -> None:
        upper = sparse.csr_matrix((values, self._indices, self._indptr), shape=(self.n, self.n))
        full = (upper + sparse.triu(upper, 1).T).tocsc()
        try:
            self._lu = sparse.linalg.splu(
                full, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
            )
        except RuntimeError as error:
            raise singular(str(error)) from error
        self.n_factorisations += 1

    def solve(self, rhs: Array) -> Array:
        x = np.asarray(self._lu.solve(rhs))
        if not np.isfinite(x).all():
            raise singular("the solution is not finite")
        return x

    @property
    def n_perturbed(self) -> int:
        """Always 0: SuperLU raises an error instead of perturbing pivots."""
        return 0

    @property
    def solves_per_factor(self) -> float:
        return 40.0

    def close(self) -> None:
        self._lu = None


_LIBRARY: list[Any] = []


def _mkl() -> Any:
    """The MKL library with pardiso's signature set, loaded once."""
    if not _LIBRARY:
        # no busy waiting of idle threads: on a loaded machine it costs more than it saves
        os.environ.setdefault("KMP_BLOCKTIME", "0")
        from pypardiso import PyPardisoSolver

        _LIBRARY.append(PyPardisoSolver().libmkl)
    return _LIBRARY[0]


def has_pardiso() -> bool:
    """Whether MKL Pardiso can be used here."""
    try:
        _mkl()
    except (ImportError, OSError):
        return False
    return True


def make(
    indptr: IntArray,
    indices: IntArray,
    *,
    kind: str = "auto",
    threads: int = 2,
    single: bool = False,
    last: IntArray | None = None,
) -> LinearSolver:
    """Create a direct solver: "multifrontal" (our own, also "auto"), "pardiso" or "superlu".

    last : equations to eliminate last, which form the multifrontal solver's root front
    """
    if kind in ("auto", "multifrontal"):
        from limbcli.fem.linear_solvers.multifrontal import Multifrontal

        return Multifrontal(indptr, indices, threads=threads, single=single, last=last)
    if kind == "pardiso" and not has_pardiso():
        raise ToolError(
            "MKL Pardiso is not installed", where="linear solver", fix="pip install pypardiso, or use superlu"
        )
    return (Pardiso if kind == "pardiso" else SuperLU)(indptr, indices, threads=threads, single=single)
