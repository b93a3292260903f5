"""The solves behind `limbcli cohort`: makes limbcli/inference/layered_family.csv, solve by solve, resumable.

    python -m tests.benchmarks.cohort_family --solves 150              # the family
    python -m tests.benchmarks.cohort_family --solves 12 --fine        # some of it on a finer mesh
    python -m tests.benchmarks.cohort_family --held-out 20             # others, to check the emulator with

A row of the file is one strain of one member. The members are a scrambled Sobol sequence (seed 7), so any
beginning of it fills the family evenly; held-out members are of another seed. What a solve cannot reach is
left out.
"""

from __future__ import annotations

import argparse
import csv
import time
from pathlib import Path

import numpy as np
from scipy.stats import qmc

from limbcli.errors import SolveError
from limbcli.inference import layered_family as solves
from tests.benchmarks.layered_member import STRAINS, Answer, Member, solve_member
from tests.benchmarks.layered_slab import CellCounts

FILE = Path(__file__).resolve().parents[2] / "limbcli" / "inference" / "layered_family.csv"
COLUMNS = (
    "mesh",
    "member",
    "thickness",
    "fat_share",
    "skin",
    "ratio",
    "m",
    "strain",
    "force",
    "below_skin",
    "below_fat",
    "force_by_ratio",
    "force_by_m",
    "skin_by_ratio",
    "skin_by_m",
    "fat_by_ratio",
    "fat_by_m",
)
LOW, HIGH = (ends[:-1] for ends in (solves.LOW, solves.HIGH))  # of all coordinates but the strain
THICKEST_SKIN = 0.25  # of the whole
MESHES = {"family": CellCounts(), "fine": CellCounts(4, 3, 2, 5, 1, 2, 2)}
FINE_STRAINS = (0.05, 0.12, 0.2)  # a finer mesh is there to tell what a mesh does; without derivatives
SEED, HELD_OUT_SEED = 7, 11


def members(n: int, seed: int) -> list[Member]:
    """The first n of a scrambled Sobol sequence over the family's bounds."""
    sequence = qmc.Sobol(len(LOW), scramble=True, seed=np.random.default_rng(seed))
    unit = sequence.random(2 ** int(np.ceil(np.log2(max(n, 2)))))[:n]
    found = []
    for each in LOW + unit * (HIGH - LOW):
        thickness = float(np.exp(each[0]))
        skin = float(min(each[2], THICKEST_SKIN * thickness))
        found.append(Member(thickness, float(each[1]), skin, float(np.exp(each[3])), float(np.exp(each[4]))))
    return found


def rows(mesh: str, number: int, member: Member, answer: Answer) -> list[list[object]]:
    own = [mesh, number, *(f"{each:.6g}" for each in vars(member).values())]
    values = np.column_stack(
        [
            answer.strain,
            answer.force,
            answer.below_skin,
            answer.below_fat,
            answer.force_slopes,
            answer.below_skin_slopes,
            answer.below_fat_slopes,
        ]
    )
    return [[*own, *(f"{each:.6g}" for each in row)] for row in values]


def make(path: Path, mesh: str, n: int, seed: int) -> None:
    """Add the members that the file lacks."""
    kind = mesh if seed == SEED else f"held-out {mesh}"
    known: set[tuple[str, str]] = set()
    if path.exists():
        with path.open(newline="", encoding="utf-8") as stream:
            known = {(row["mesh"], row["member"]) for row in csv.DictReader(stream)}
    else:
        path.write_text(",".join(COLUMNS) + "\n", encoding="utf-8")
    for number, member in enumerate(members(n, seed)):
        if (kind, str(number)) in known:
            continue
        started = time.process_time()
        try:
            strains = FINE_STRAINS if mesh == "fine" else STRAINS
            answer = solve_member(member, counts=MESHES[mesh], strains=strains, gradients=mesh != "fine")
        except SolveError as error:
            print(f"{kind} {number}: {error.what}", flush=True)
            continue
        with path.open("a", newline="", encoding="utf-8") as stream:
            csv.writer(stream, lineterminator="\n").writerows(rows(kind, number, member, answer))
        seconds = time.process_time() - started
        print(f"{kind} {number}: {len(answer.strain)} strains, {seconds:.1f} processor s", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--solves", type=int, default=0, help="members of the family")
    parser.add_argument("--held-out", type=int, default=0, help="members that the emulator never sees")
    parser.add_argument("--fine", action="store_true", help="on the finer mesh")
    parser.add_argument("--out", type=Path, default=FILE)
    given = parser.parse_args()
    mesh = "fine" if given.fine else "family"
    make(given.out, mesh, given.solves, SEED)
    make(given.out, mesh, given.held_out, HELD_OUT_SEED)


if __name__ == "__main__":
    main()
