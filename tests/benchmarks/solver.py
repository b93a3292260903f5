"""The reference solver's benchmark: one row per model, and FEBio on the same file where it is found.

    python -m tests.benchmarks [--quick] [MODEL.feb ...]

Without files it runs the reference data's punch and limb models. A fresh process per row keeps the
peak memory honest. Seconds are wall time; "cpu" is what the process used on all threads, the figure to
trust on a busy machine. "derivative" is the time of one more parameter over that of the solve.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from limbcli.model import LimbModel

HEADINGS = (
    "model", "element", "dofs", "levels", "solver", "linear solver", "factorisations", "iterations",
    "solves", "seconds", "cpu", "peak MB", "derivative",
)  # fmt: skip
QUICK = ("effect-base-tet4/model.feb", "effect-base/model.feb", "punch-tet4/model.feb.gz")
FULL = (
    *QUICK,
    "punch-tet10-quarter/model.feb.gz",
    "limb-posterior/tet4.feb.gz",
    "limb-posterior/tet10.feb.gz",
)


def measure(path: Path, threads: int) -> dict[str, object]:
    """One solve without derivatives, then the cost of one parameter at every level."""
    from limbcli.feb.read import read_feb
    from limbcli.fem.analysis import Analysis, Snapshot
    from limbcli.fem.derivatives.parameters import LawParameter
    from limbcli.fem.derivatives.sensitivity import sensitivities
    from limbcli.solvers.reference import prepare

    model = read_feb(path)
    cost = [0.0]

    def differentiate(analysis: Analysis, snapshot: Snapshot) -> None:
        start = time.process_time()
        name, material = next(iter(model.materials.items()))
        first = min(k for k, v in material.parameters.items() if isinstance(v, float))
        parameter = LawParameter(name, {first: 1.0})
        sensitivities(analysis.newton, snapshot.state, snapshot.forces, [parameter])
        cost[0] += time.process_time() - start

    load_kernels(model)
    wall, cpu = time.perf_counter(), time.process_time()
    analysis = prepare(model, threads=threads)
    snapshots = analysis.run(differentiate)
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    counts = analysis.totals()
    share = cost[0] / cpu
    return {
        "model": path.parent.name,
        "element": model.mesh.solid_blocks[0].kind,
        "dofs": analysis.system.n_unknowns,
        "levels": len(snapshots),
        "solver": "reference",
        "linear solver": analysis.newton.linear_name,
        "factorisations": counts.factorisations,
        "iterations": counts.iterations,
        "seconds": f"{wall * (1 - share):.1f}",
        "cpu": f"{cpu - cost[0]:.1f}",
        "peak MB": f"{resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f}",
        "derivative": f"{cost[0] / max(cpu - cost[0], 1e-9):.3f}",
    }


def load_kernels(model: LimbModel) -> None:
    """Call every compiled kernel once, so that neither compiling nor loading is timed."""
    import numpy as np

    from limbcli.fem.system import System

    system = System(model, threads=1)
    state = system.rest()
    contact = system.forces(state).contact
    system.add_contact(contact, system.pattern.values(system.stiffness(state)))
    zero = np.zeros_like(state.u)
    system.tangent_times(state, zero)
    system.contact_times(contact, zero, np.zeros((len(system.bodies), 6)))


def growth(rows: list[dict[str, object]]) -> str:
    """How the time grows with the number of unknowns, by kind of element."""
    import numpy as np

    lines = []
    for kind in sorted({str(r["element"]) for r in rows if "cpu" in r}):
        mine = [r for r in rows if r.get("element") == kind and "cpu" in r]
        dofs = np.log([float(str(r["dofs"])) for r in mine])
        if len(mine) > 1 and np.ptp(dofs) > 0.1:
            per_level = [float(str(r["cpu"])) / int(str(r["levels"])) for r in mine]
            slope = np.polyfit(dofs, np.log(np.maximum(per_level, 1e-3)), 1)[0]
            lines.append(f"{kind}: cpu time of a level grows as dofs^{slope:.2f}")
    return "\n".join(lines)


def measure_febio(path: Path) -> dict[str, object] | None:
    """FEBio on a copy of the file, or None where there is no FEBio."""
    import shutil

    from limbcli.errors import LimbError
    from limbcli.feb.log import read_log
    from limbcli.progress import SILENT
    from limbcli.solvers.febio import FebioSolver

    solver = FebioSolver()
    if not solver.found():
        return None
    with tempfile.TemporaryDirectory() as folder:
        feb = Path(shutil.copy(path, Path(folder) / path.name))
        wall = time.perf_counter()
        try:
            solver.run(feb, progress=SILENT)
        except LimbError as error:
            return {"model": path.parent.name, "solver": f"FEBio: {error.what.splitlines()[0]}"}
        wall = time.perf_counter() - wall
        log = read_log(feb.parent / "model.log")
    return {
        "model": path.parent.name,
        "dofs": log.n_equations,
        "levels": len(log.times),
        "solver": f"FEBio {log.version}",
        "linear solver": log.linear_solver,
        "factorisations": log.n_reformations,
        "iterations": log.n_iterations,
        "seconds": f"{wall:.1f}",
    }


def table(rows: list[dict[str, object]]) -> str:
    """Rows as a table in Markdown."""
    cells = [[str(row.get(name, "")) for name in HEADINGS] for row in rows]
    widths = [max(len(h), *(len(c[k]) for c in cells)) for k, h in enumerate(HEADINGS)]
    lines = [HEADINGS, ["-" * w for w in widths], *cells]
    return "\n".join(
        "| " + " | ".join(c.ljust(w) for c, w in zip(line, widths, strict=True)) + " |" for line in lines
    )


def models(quick: bool) -> list[Path]:
    """The reference data's models, where the data are there."""
    import os

    here = Path(__file__).resolve().parents[2]
    shared = Path(os.environ.get("LIMBCLI_SHARED", here.parent / "shared")) / "febio-golden"
    return [shared / name for name in (QUICK if quick else FULL) if (shared / name).is_file()]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("files", nargs="*", type=Path)
    parser.add_argument("--quick", action="store_true", help="small models only")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--one", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        print(json.dumps(measure(options.one, options.threads)))
        return
    rows: list[dict[str, object]] = []
    for path in options.files or models(options.quick):
        command = [
            sys.executable,
            "-m",
            "tests.benchmarks",
            "--one",
            str(path),
            "--threads",
            str(options.threads),
        ]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            rows.append({"model": path.parent.name, "solver": done.stderr.strip().splitlines()[-1][:80]})
        else:
            rows.append(json.loads(done.stdout.splitlines()[-1]))
        other = measure_febio(path)
        rows += [other] if other else []
        print(table(rows), flush=True)
    print(growth(rows))


if __name__ == "__main__":
    main()
