"""One limb in its socket in both solvers, pressure by pressure.

    limbcli segment CASE --out OUT; limbcli limb CASE --out OUT --c-kpa 16
    python -m tests.benchmarks.socket_febio CASE --out OUT --work DIR [--friction 0.3] [--penetration-mm 0.1]
        [--donning-steps 10] [--load-steps 5] [--slip-as-febio] [--only reference]

Writes socket.feb as `limbcli socket` does, and own.feb with the load steps of the reference solver (with
--slip-as-febio FEBio takes as many). Runs FEBio (found as limbcli finds it, or --febio) on the first and the
reference solver on the second, each in a process of its own, on one thread, and prints a row for each state:
the difference of the facets' pressures (rms over the area, as a share of the rms pressure), the same at the
nodes (weighted by area), of the total (pressure times area), the axial forces on the socket, processor
seconds and peak memory. With a liner that slides they are those on the skin. The pressure of a facet is the
plain mean over its integration points, as FEBio logs it. What has run is kept in DIR.
"""

from __future__ import annotations

import argparse
import os
import re
import resource
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np

if __package__ in (None, ""):
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # run as a script

from limbcli.case import Case
from limbcli.case.reading import CaseReading
from limbcli.case.socket import read_socket
from limbcli.feb.read import read_feb
from limbcli.feb.records import read_records
from limbcli.feb.write import write_feb
from limbcli.fem.contacts.contact_points import TRACTION
from limbcli.model import Array, LimbModel, LogRecord
from limbcli.model.npz_file import load_model
from limbcli.sockets.donning import SOCKET, don_and_load, for_febio, tractions
from limbcli.solvers.febio import FebioSolver
from limbcli.stages.in_socket.limb_in_socket import put_together
from limbcli.stages.socket import SocketOptions, donning_options

REFERENCE, FEBIO, OWN = "reference.npz", "febio.npz", "own.feb"
PRESSURE = '<face_data data="contact pressure" delim="," file="pressure.txt" surface="{}"/></logfile>'
FORCE = LogRecord("rigid_body", ("Fz", "z"), "force.txt", SOCKET)


def written(options: argparse.Namespace, feb: Path) -> None:
    """socket.feb and own.feb of a case with FEBio's records of pressures and of the socket."""
    case = Case.open_images(options.case)
    reading = CaseReading.of(case.raw, case.folder)
    given = read_socket(case.raw, reading)
    if given is None:
        raise SystemExit("\n".join(map(str, reading.problems)) or f"{options.case} gives no [socket]")
    if options.friction is not None:
        given = replace(given, friction=options.friction)
    together = put_together(
        load_model(options.out / "limb" / "model.npz"), given, SimpleNamespace(warnings=[])
    )
    asked = donning_options(
        given,
        SocketOptions(
            donning_steps=options.donning_steps, load_steps=options.load_steps,
            contact_penalty=options.contact_penalty, penetration_mm=options.penetration_mm,
        ),
        together,
    )  # fmt: skip
    # solved, as the first load begins with what holds the donned socket
    asked = replace(asked, slip_as_febio=options.slip_as_febio)
    model = don_and_load(together.limb, together.face, asked, threads=1).model
    with_records(model, feb.with_name(OWN))
    with_records(model if options.slip_as_febio else for_febio(model), feb)


def with_records(model: LimbModel, feb: Path) -> None:
    text = write_feb(replace(model, records=(FORCE,)), feb.with_name("plain.feb")).read_text()
    feb.write_text(text.replace("</logfile>", PRESSURE.format(model.contacts[-1].primary)))


def ends(model: LimbModel) -> list[float]:
    """Times of the states: end of donning, and of each load."""
    begin, found = 0.0, []
    for step in model.steps:
        found += [begin + each for each in step.must_points]
        begin += step.must_points[-1]
    return found


def reference(feb: Path, *, slip_as_febio: bool = False) -> None:
    """Solve in this process: per state the facets' pressures, areas, force and height of the socket."""
    from limbcli.solvers.reference import prepare

    model = read_feb(feb)
    states = []

    def visit(running, snapshot) -> None:
        print(f"step {snapshot.part}.{snapshot.step} at {time.process_time():.1f} s", flush=True)
        if snapshot.must:
            pair, contact = running.system.pairs[-1], snapshot.forces.contact.points[-1]
            area, _, shear = (
                np.concatenate(x) for x in zip(*map(tractions, pair.patches, contact), strict=True)
            )
            pressure = np.concatenate([points[..., TRACTION].mean(axis=1) for points in contact])
            b = [each.name for each in running.system.bodies].index(SOCKET)
            force, shift = snapshot.forces.bodies[b, 2], snapshot.state.bodies[b].shift[2]
            states.append((pressure, area, np.linalg.norm(shear, axis=1), force, shift))

    analysis = prepare(model, threads=1, slip_as_febio=slip_as_febio)
    analysis.run(visit)
    used = resource.getrusage(resource.RUSAGE_SELF)
    pressure, area, shear, force, shift = map(np.array, zip(*states, strict=True))
    np.savez(
        feb.parent / REFERENCE, pressure=pressure, area=area, shear=shear, force=force, shift=shift,
        iterations=analysis.totals().iterations, seconds=used.ru_utime + used.ru_stime,
        peak_mb=used.ru_maxrss / 1024,
    )  # fmt: skip


def febio(feb: Path, binary: Path) -> None:
    """Run FEBio on the file; the same quantities, areas left out."""
    model = read_feb(feb)
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
    with (feb.parent / "screen.txt").open("w") as screen:
        command = [binary, "-i", feb.name, "-p", os.devnull]
        process = subprocess.Popen(command, cwd=feb.parent, env=environment, stdout=screen)
        _, status, used = os.wait4(process.pid, 0)
    log = feb.with_suffix(".log").read_text(errors="replace")
    if "N O R M A L" not in log:
        raise SystemExit(f"FEBio stopped ({status}) after {used.ru_utime:.0f} s:\n{log[-1500:]}")
    pressures, forces = read_records(feb.parent / "pressure.txt"), read_records(feb.parent / "force.txt")
    at = [int(np.argmin(abs(pressures.times - each))) for each in ends(model)]
    # of each analysis step, and last of all of them
    totals = re.findall(r"Total number of equilibrium iterations \.+ : (\d+)", log)
    np.savez(
        feb.parent / FEBIO, pressure=pressures.values[at, :, 0], force=forces.values[at, 0, 0],
        height=forces.values[at, 0, 1], iterations=int(totals[-1]) if totals else -1,
        seconds=used.ru_utime + used.ru_stime, peak_mb=used.ru_maxrss / 1024,
    )  # fmt: skip


def at_nodes(facets: Array, pressure: Array, area: Array) -> tuple[Array, Array]:
    """Pressure and area at the nodes: means over their facets, weighted by area."""
    sums = np.zeros((facets.max() + 1, 2))
    for column in facets.T:
        np.add.at(sums, column, np.stack([area, area * pressure], axis=1))
    used = sums[:, 0] > 0
    return sums[used, 1] / sums[used, 0], sums[used, 0]


def share(a: Array, b: Array, weight: Array) -> float:
    return float(np.sqrt((weight * (a - b) ** 2).sum() / (weight * b**2).sum()))


def rows(feb: Path) -> list[str]:
    model = read_feb(feb)
    facets = next(iter(model.mesh.surfaces[model.contacts[-1].primary].facets.values()))[:, :3]
    ours, theirs = (dict(np.load(feb.parent / name)) for name in (REFERENCE, FEBIO))
    found = []
    for k in range(len(ends(model))):
        area, p, q = ours["area"][k], ours["pressure"][k], theirs["pressure"][k]
        (np_, weight), (nq, _) = at_nodes(facets, p, area), at_nodes(facets, q, area)
        total = (area * p).sum() / (area * q).sum() - 1
        found.append(
            f"| {'donned' if k == 0 else f'load {k}'} | {100 * share(p, q, area):.1f} % "
            f"| {100 * share(np_, nq, weight):.1f} % | {100 * total:+.2f} % "
            f"| {abs(ours['force'][k]):.1f}, {abs(theirs['force'][k]):.1f} |"
        )
    cost = [
        f"{x['iterations']} iterations, {x['seconds']:.0f} s, {x['peak_mb']:.0f} MB" for x in (ours, theirs)
    ]
    return [*found, f"reference: {cost[0]}; FEBio: {cost[1]}; {len(model.mesh.points)} nodes"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("case", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--febio", type=Path)
    parser.add_argument("--friction", type=float, help="default: the case's")
    parser.add_argument("--contact-penalty", type=float, default=SocketOptions.contact_penalty)
    parser.add_argument("--penetration-mm", type=float, default=SocketOptions.penetration_mm)
    parser.add_argument("--donning-steps", type=int, default=SocketOptions.donning_steps)
    parser.add_argument("--load-steps", type=int, default=SocketOptions.load_steps)
    parser.add_argument("--slip-as-febio", action="store_true", help="in the reference solver")
    parser.add_argument("--only", choices=["reference", "febio"])
    options = parser.parse_args()
    options.work.mkdir(parents=True, exist_ok=True)
    feb = options.work / "socket.feb"
    if not feb.is_file():
        written(options, feb)
    if options.only == "reference":
        return reference(feb.with_name(OWN), slip_as_febio=options.slip_as_febio)
    if not (options.work / REFERENCE).is_file() and options.only != "febio":
        module = [sys.executable, "-m", "tests.benchmarks.socket_febio"]
        subprocess.run([*module, *sys.argv[1:], "--only", "reference"], check=True)
    if not (options.work / FEBIO).is_file():
        febio(feb, FebioSolver(binary=options.febio).need())
    if options.only is None:
        print("| state | facets | nodes | total | axial force, N |\n|-|-|-|-|-|\n" + "\n".join(rows(feb)))


if __name__ == "__main__":
    main()
