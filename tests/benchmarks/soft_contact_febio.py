"""Two soft blocks pressed together in both solvers: pressures of the facets, facet by facet.

    python -m tests.benchmarks.soft_contact_febio --work DIR [--febio FILE]

The blocks of `tests/fem/test_soft_contact.py`, of meshes that do not match: pressed together by 0.6 mm, with
friction also dragged by 0.5 mm, in 4 steps. FEBio shortens steps in which it inverts cells, and augmented
pressures depend on the steps; the reference solver takes those that FEBio took. Prints a row per case: their
number, the difference of the facets' pressures (rms over the area, as a share of the rms pressure), and of
the total.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "fem"))
from test_soft_contact import stacked

from limbcli.feb.read import read_feb
from limbcli.feb.records import read_records
from limbcli.feb.write import write_feb
from limbcli.fem.contacts.contact_points import TRACTION
from limbcli.model import LimbModel, LogRecord, Step, Support
from limbcli.model.bodies import Contact
from limbcli.sockets.donning import tractions
from limbcli.solvers.febio import FebioSolver
from limbcli.solvers.reference import prepare
from tests.benchmarks.socket_febio import PRESSURE, share

# kind, friction, augmented, slip as FEBio
CASES = (
    ("tet4", 0.0, False, False), ("tet10", 0.0, False, False), ("hex8", 0.0, False, False),
    ("tet4", 0.0, True, False), ("tet10", 0.0, True, False), ("hex8", 0.0, True, False),
    ("tet4", 0.3, False, True), ("hex8", 0.3, False, True), ("hex8", 0.3, False, False),
)  # fmt: skip


def model(kind: str, friction: float, *, augmented: bool) -> LimbModel:
    more = {"tolerance": 0.0, "gap_tolerance": 0.005, "more": {"maxaug": "20"}} if augmented else {}
    contact = Contact(
        "top", "bottom", search_radius=2.0, friction=friction, symmetric=False, augmented=augmented, **more
    )
    blocks = stacked(kind, (5, 5, 3), (3, 3, 2), contact=contact, side=8.3, shift=-1.1)
    control = {
        "symmetric_stiffness": "non-symmetric", "max_refs": 25, "qn_method": "Broyden", "max_ups": 10,
    }  # fmt: skip
    step = Step(n_steps=4, step_size=0.25, dt_max=0.25, must_points=(1.0,), control=control)
    supports = (
        Support("z0", ("x", "y", "z")),
        Support("upper_z1", ("x",), 0.5 if friction else 0.0, "ramp"),
        Support("upper_z1", ("y",)),
        Support("upper_z1", ("z",), -0.6, "ramp"),
    )
    record = LogRecord("node", ("z",), "nodes.txt")
    return replace(blocks, supports=supports, steps=(step,), records=(record,))


def compared(feb: Path, binary: Path, *, slip_as_febio: bool) -> str:
    text = feb.read_text().replace("</logfile>", PRESSURE.format("top"))
    feb.write_text(text)
    subprocess.run(
        [binary, "-i", feb.name, "-p", os.devnull], cwd=feb.parent, capture_output=True, check=False
    )
    if "N O R M A L" not in feb.with_suffix(".log").read_text(errors="replace"):
        return "FEBio found no equilibrium"
    record = read_records(feb.parent / "pressure.txt")
    times = tuple(float(each) for each in record.times if each > 0)
    read = read_feb(feb)
    again = replace(read, steps=(replace(read.steps[0], must_points=times),))
    analysis = prepare(again, threads=1, slip_as_febio=slip_as_febio)
    found = analysis.run()[-1].forces.contact.points[0][0]
    area, _, _ = tractions(analysis.system.pairs[0].patches[0], found)
    ours = found[..., TRACTION].mean(axis=1)
    theirs = record.values[-1][:, 0]
    total = (area @ ours) / (area @ theirs) - 1
    return f"{len(times)} | {100 * share(ours, theirs, area):.2f} % | {100 * total:+.2f} %"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--febio", type=Path)
    given = parser.parse_args()
    binary = FebioSolver(binary=given.febio).need()
    print("| blocks | steps | facets | total |\n|-|-|-|-|")
    for kind, friction, augmented, slip in CASES:
        words = f"{kind}, friction {friction:g}" + ", augmented" * augmented + ", slip as FEBio" * slip
        folder = given.work / words.replace(" ", "_")
        folder.mkdir(parents=True, exist_ok=True)
        feb = write_feb(model(kind, friction, augmented=augmented), folder / "model.feb")
        print(f"| {words} | {compared(feb, binary, slip_as_febio=slip)} |", flush=True)


if __name__ == "__main__":
    main()
