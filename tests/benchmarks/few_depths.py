"""What few depths leave of the curves of models with effects, against all depths, and the work they save.

    python -m tests.benchmarks.few_depths CASE OUT

OUT holds `segment` and `mesh` of the case; its first site is simulated with every effect that the diagnosis
simulates, at its start value.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from limbcli.case import Case
from limbcli.diagnosis.curves.curve_plan import FIRST_M, USUAL_M
from limbcli.diagnosis.prepare import Preparation, WorkingMesh
from limbcli.effects import EFFECTS
from limbcli.effects.ingredients import touches_loads
from limbcli.errors import LimbError
from limbcli.progress import SILENT


def main(folder: Path, out: Path) -> None:
    case = Case.open(folder)
    made = Preparation(case, case.sites[0], out, WorkingMesh(), SILENT).simulated()
    made.solver.memo = type(made.solver.memo)(None)  # nothing kept, nothing found
    for m in FIRST_M:
        made.curves(m)
    few = made.few
    print("effect: work at all depths, at few; largest error over the largest force; of ln speed, rms")
    for each in EFFECTS:
        if each.febio_only or not (each.spreads or each.new_mesh or touches_loads(each, made.model)):
            continue
        ingredients, found, work = ((each, each.start),), [], []
        for depths in (made.depths, few):
            made.few = depths
            before = made.work.total
            try:
                found.append(made.curves(USUAL_M, ingredients))
            except LimbError as error:
                print(each.name, error.what)
                break
            work.append(made.work.total - before)
            made._known.pop(made.models.key(USUAL_M, ingredients))
        if len(found) == 2:
            whole, some = found
            force = np.max(np.abs(some.force - whole.force)) / whole.force.max()
            speed = np.sqrt(np.nanmean((some.log_speed - whole.log_speed) ** 2))
            print(f"{each.name}: {work[0]}, {work[1]}; {force:.4f}; {speed:.4f}", flush=True)
    made.close()


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:3]))
