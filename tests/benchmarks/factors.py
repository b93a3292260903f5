"""The direct solver against others on the same matrices: analysis, factor, substitution, memory, whole solve.

    pip install "limbcli[factors]"   # MKL Pardiso, MUMPS, CHOLMOD: what is not there is left out
    python -m tests.benchmarks.factors [--mesh coarse|usual] [--site h15] [--no-whole] [--threads 2]

The matrix is that of a site of the FEBio study in the reference data (see hard_solves.py) half-way into its
tissue; every solver runs in a process of its own. "whole" is a solve of that model (m 5, f_kappa 100, penalty
20, 25 % of the tissue, eight levels), where only the multifrontal solver can take the contact into its root.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sparse

from limbcli.errors import LimbError
from limbcli.fem.linear_solvers import direct as linear
from limbcli.fem.linear_solvers.singular import singular
from limbcli.model import Array, IntArray, LimbModel
from limbcli.solvers.reference import prepare

KINDS = (
    "multifrontal", "multifrontal, double", "pardiso", "pardiso, single", "mumps",
    "cholmod", "superlu",
)  # fmt: skip


TOLERANCE = {"coarse": 1e-3, "usual": 1e-6}


class Adapter:
    """What the other packages have in common: a full symmetric matrix, its factor, solutions."""

    n_perturbed, solves_per_factor = 0, 20.0

    def __init__(self, indptr: IntArray, indices: IntArray, **options: Any):
        self.n, self._indptr, self._indices = len(indptr) - 1, indptr, indices
        self.n_factorisations = 0
        self.analyse(self._matrix(np.ones(len(indices))))

    def _matrix(self, values: Array) -> sparse.csr_matrix:
        upper = sparse.csr_matrix((values, self._indices, self._indptr), shape=(self.n, self.n))
        return upper

    def factor(self, values: Array) -> None:
        self.n_factorisations += 1
        self.renew(self._matrix(values))

    def close(self) -> None: ...

    def analyse(self, upper: sparse.csr_matrix) -> None: ...

    def renew(self, upper: sparse.csr_matrix) -> None:
        raise NotImplementedError


class Mumps(Adapter):
    name = "MUMPS (python-mumps)"

    def renew(self, upper: sparse.csr_matrix) -> None:
        import mumps

        context = mumps.Context()
        context.set_matrix(upper.tocoo(), symmetric=True)
        context.factor(ordering="metis")
        self._context = context

    def solve(self, rhs: Array) -> Array:
        return np.asarray(self._context.solve(rhs))


class Cholmod(Adapter):
    name = "CHOLMOD (scikit-sparse)"

    def analyse(self, upper: sparse.csr_matrix) -> None:
        from sksparse.cholmod import analyze

        pattern = (upper + sparse.triu(upper, 1).T).tocsc()
        pattern.setdiag(pattern.shape[0])
        self._symbolic = analyze(pattern, mode="supernodal", ordering_method="metis")

    def renew(self, upper: sparse.csr_matrix) -> None:
        from sksparse.cholmod import CholmodError

        full = (upper + sparse.triu(upper, 1).T).tocsc()
        try:
            self._factor = self._symbolic.cholesky(full)
        except CholmodError as error:
            raise singular(str(error)) from error

    def solve(self, rhs: Array) -> Array:
        return np.asarray(self._factor(rhs))


def maker(kind: str) -> Any:
    """A surrogate for `linear.make`."""
    ours = linear.make

    def make(indptr: IntArray, indices: IntArray, **options: Any) -> Any:
        if kind in ("mumps", "cholmod"):
            return (Mumps if kind == "mumps" else Cholmod)(indptr, indices)
        name, _, how = kind.partition(", ")
        single = how == "single" or kind == "multifrontal"
        return ours(indptr, indices, **{**options, "kind": name, "single": single})

    return make


def model_of(site: str, mesh: str, folder: Path) -> LimbModel:
    from tests.benchmarks.hard_solves import Row, built

    return built(Row(site, 5.0, 100.0, 20.0, 0.25), mesh, folder)[0]


def measure(kind: str, site: str, mesh: str, folder: Path, *, whole: bool, threads: int) -> dict[str, Any]:
    linear.make = maker(kind)  # type: ignore[assignment]
    model = model_of(site, mesh, folder)
    reported: dict[str, Any] = {"solver": kind}
    values, indptr, indices, last = matrix(site, mesh, folder, threads)
    before, clock = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.perf_counter()
    solver = linear.make(indptr, indices, threads=threads, last=last)
    solver.factor(values)  # what is compiled or allocated at first
    solver.solve(np.ones(len(indptr) - 1))
    reported["analysis and first s"] = round(time.perf_counter() - clock, 2)
    reported["factor ms"] = round(1e3 * _best(lambda: solver.factor(values), 5), 1)
    rhs = np.random.default_rng(7).standard_normal(len(indptr) - 1)
    reported["substitution ms"] = round(1e3 * _best(lambda: solver.solve(rhs), 9), 2)
    reported["grew by MB"] = round((resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024)
    solver.close()
    if whole:
        analysis = prepare(model, threads=threads, tolerance=TOLERANCE[mesh])
        clock, cpu = time.perf_counter(), time.process_time()
        try:
            analysis.run()
            counts = analysis.totals()
            reported |= {
                "whole s": round(time.perf_counter() - clock, 1),
                "whole cpu s": round(time.process_time() - cpu, 1),
                "factorisations": counts.factorisations, "Krylov": counts.krylov,
                "iterations": counts.iterations,
            }  # fmt: skip
        except LimbError as error:
            reported["whole s"] = error.what[:60]
    return reported


def matrix(site: str, mesh: str, folder: Path, threads: int) -> tuple[Array, IntArray, IntArray, IntArray]:
    """Values, pattern and last equations of a tangent half-way in; kept in the folder."""
    path = folder / f"matrix-{site}-{mesh}.npz"
    if not path.is_file():
        raise SystemExit(f"{path} is missing: run without --one")
    kept = np.load(path)
    return kept["values"], kept["indptr"], kept["indices"], kept["last"]


def keep_matrix(site: str, mesh: str, folder: Path, threads: int) -> None:
    model = model_of(site, mesh, folder)
    analysis = prepare(model, threads=threads, tolerance=1e-3)

    def stop(running: Any, found: Any) -> None:
        if found.state.time > 0.5 * model.steps[0].must_points[-1]:
            raise StopIteration

    with contextlib.suppress(StopIteration):
        analysis.run(stop)
    system, state = analysis.system, analysis.newton.linearised.inverse.tangent.state
    pattern, tangent = system.pattern, analysis.newton.linearised.inverse.tangent
    values = system.add_contact(system.search(state), tangent.upper())
    np.savez(
        folder / f"matrix-{site}-{mesh}.npz", values=values,
        indptr=pattern.indptr, indices=pattern.indices, last=system.within_reach(),
    )  # fmt: skip
    analysis.close()


def _best(call: Any, n: int) -> float:
    times = []
    for _ in range(n):
        clock = time.perf_counter()
        call()
        times.append(time.perf_counter() - clock)
    return float(np.median(times))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--mesh", choices=sorted(TOLERANCE), default="usual")
    parser.add_argument("--site", default="h15")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--no-whole", action="store_true")
    parser.add_argument("--work", type=Path, default=Path(tempfile.gettempdir()) / "hard-solves")
    parser.add_argument("--one", choices=KINDS, help=argparse.SUPPRESS)
    options = parser.parse_args()
    where = options.site, options.mesh, options.work
    if options.one:
        found = measure(options.one, *where, whole=not options.no_whole, threads=options.threads)
        print(json.dumps(found))
        return
    options.work.mkdir(parents=True, exist_ok=True)
    keep_matrix(*where, options.threads)
    heads: list[str] = []
    for kind in KINDS:
        command = [sys.executable, __file__, *sys.argv[1:], "--one", kind]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            print(f"| {kind} | {(done.stderr.strip().splitlines() or ['failed'])[-1][:90]} |", flush=True)
            continue
        found = json.loads(done.stdout.splitlines()[-1])
        if not heads:
            heads = list(found)
            print("| " + " | ".join(heads) + " |\n|" + "-|" * len(heads))
        print("| " + " | ".join(str(found.get(head, "")) for head in heads) + " |", flush=True)


if __name__ == "__main__":
    main()
