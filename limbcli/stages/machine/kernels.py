"""The reference solver's kernels, compiled in two more processes while images are read and meshes made.

Only where none is on disk yet and there is more than one core. They compile what a small simulation of
each kind calls, into numba's cache; `fem.supported.warm_up` waits for them.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from limbcli import background_processes
from limbcli.config import at_most
from limbcli.errors import LimbError

_MODULE = "limbcli.stages.machine.kernels"  # also where it is called as a program, and named otherwise
_FINE = 7  # cells along an edge of the self test's block: enough equations for single precision


def compile_ahead(*, solver: str = "reference", febio: Path | None = None) -> None:
    """Begin, if it is worth it and this solver (as of `solvers.choose`) is the reference solver."""
    from limbcli.solvers import choose
    from limbcli.solvers.reference import NAME, kernels_are_there

    try:
        if choose(solver, febio).name != NAME:
            return
    except LimbError:  # the stage that needs it says so
        return
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if at_most(cores) > 1 and not background_processes.at_work() and not kernels_are_there():
        for part in PARTS:
            background_processes.start(_MODULE, part)


def equations() -> None:
    """Of the direct solver, in single precision as for all limbs: a small matrix."""
    import scipy.sparse as sparse

    from limbcli.solvers.reference import direct_solver

    n = 400
    apart = np.concatenate([np.full(n, 4.0), np.full(n - 1, -1.0), np.full(n - 20, -1.0)])
    rows = np.concatenate([np.arange(n), np.arange(n - 1), np.arange(n - 20)])
    columns = np.concatenate([np.arange(n), np.arange(1, n), np.arange(20, n)])
    upper = sparse.csr_matrix((apart, (rows, columns)), shape=(n, n))
    upper.sort_indices()
    solver = direct_solver(upper.indptr, upper.indices, single=True)
    solver.factor(upper.data)
    solver.solve(np.ones(n))
    solver.close()


def simulation() -> None:
    """Of elements, contact and derivatives: a small indentation, with all that a fit asks for."""
    from limbcli.model import LogRecord
    from limbcli.solvers.session import ReferenceSession
    from limbcli.stages.machine.self_test import indentation

    model = indentation(_FINE)
    strain = LogRecord("element", ("Fxx",), "strain.csv", np.arange(1))
    session = ReferenceSession(replace(model, records=(*model.records, strain)), tolerance=1e-4)
    session.solve(records=True)
    session.solve(wrt=[("tissue", "kappa"), ("tissue", "m1-m2")], field_gradients=True)
    session.close()


PARTS: dict[str, Callable[[], None]] = {"simulation": simulation, "equations": equations}


def compile_all() -> None:
    """Both parts side by side, where they are not on disk yet."""
    from limbcli.solvers.reference import kernels_are_there

    if kernels_are_there():
        return
    for part in PARTS:
        background_processes.start(_MODULE, part)
    background_processes.wait()


if __name__ == "__main__":
    if sys.argv[1:]:
        PARTS[sys.argv[1]]()
    else:
        compile_all()
