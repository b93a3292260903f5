"""Compile the kernels of solver and mesher in two background processes while images are read.

This is done only if no kernels are cached on disk yet and there is more than one core. The processes run a
small simulation of each kind and a small mesh, which fills numba's cache; `fem.supported.warm_up` waits for
them.
"""

from __future__ import annotations

import gc
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from limbcli import background_processes
from limbcli.config import available_cores
from limbcli.errors import LimbError

_MODULE = "limbcli.stages.machine.kernels"  # explicit, because __name__ differs when run as a program
_RADIUS = 30.0  # mm, radius of the limb meshed for compilation
_FINE = 7  # cells along an edge of the self test's block: enough equations to use single precision
# Thresholds of the garbage collector, which takes a tenth of the compilation with Python's own.
_RARELY = (100_000, 10, 10)


def compile_ahead(*, solver: str = "reference", febio: Path | None = None) -> None:
    """Start compilation if it is useful and this solver (see `solvers.choose`) is the reference solver."""
    from limbcli.solvers import choose
    from limbcli.solvers.reference import NAME, kernels_are_there

    try:
        if choose(solver, febio).name != NAME:
            return
    except LimbError:  # the stage that needs the solver reports it
        return
    if available_cores() > 1 and not background_processes.at_work() and not kernels_are_there():
        for parts in _PROCESSES:
            background_processes.start(_MODULE, *parts)


def equations() -> None:
    """Compile the direct solver with a small matrix, in single precision as used for all limbs."""
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
    """Compile elements, contact and derivatives with a small indentation and everything that a fit uses."""
    from limbcli.model import LogRecord
    from limbcli.solvers.session import ReferenceSession
    from limbcli.stages.machine.self_test import indentation

    model = indentation(_FINE)
    strain = LogRecord("element", ("Fxx",), "strain.csv", np.arange(1))
    session = ReferenceSession(replace(model, records=(*model.records, strain)), tolerance=1e-4)
    session.solve(records=True)
    session.solve(wrt=[("tissue", "kappa"), ("tissue", "m1-m2")], field_gradients=True)
    session.close()


def mesher() -> None:
    """Compile distances, facets and tetrahedra by meshing a thick cylinder with a bone coarsely."""
    import manifold3d

    from limbcli.meshing.crop import crop_planes
    from limbcli.meshing.domain import make_domain
    from limbcli.meshing.mending import mend
    from limbcli.meshing.probe import PlacedProbe, ProbeShape
    from limbcli.meshing.remesh import Sizes
    from limbcli.meshing.site_mesher import mesh_volume
    from limbcli.meshing.surfaces import Triangles

    def cylinder(radius: float, length: float) -> Triangles:
        made = manifold3d.Manifold.cylinder(length, radius, circular_segments=24, center=True)
        mesh = made.rotate((90.0, 0.0, 0.0)).translate((0.0, 0.0, -_RADIUS)).to_mesh()
        return Triangles(np.asarray(mesh.vert_properties, float)[:, :3], np.asarray(mesh.tri_verts, int))

    limb = mend(cylinder(_RADIUS, 90.0), [cylinder(10.0, 100.0)])
    probe = ProbeShape(30.0, 10.0, 2.0)
    domain = make_domain(limb, crop_planes(limb, probe, 15.0), spacing=3.0)
    mesh_volume(domain, (PlacedProbe(probe),), Sizes(6.0, 12.0))


# The parts to compile; the first takes as long as the others together.
PARTS: dict[str, Callable[[], None]] = {"simulation": simulation, "equations": equations, "mesher": mesher}
_PROCESSES = (("simulation",), ("equations", "mesher"))


def compile_all() -> None:
    """Compile all parts, in two parallel processes, if the solver's kernels are not on disk yet."""
    from limbcli.solvers.reference import kernels_are_there

    if kernels_are_there():
        return
    for parts in _PROCESSES:
        background_processes.start(_MODULE, *parts)
    background_processes.wait()


if __name__ == "__main__":
    gc.freeze()
    gc.set_threshold(*_RARELY)
    for part in sys.argv[1:]:
        PARTS[part]()
    if not sys.argv[1:]:
        compile_all()
