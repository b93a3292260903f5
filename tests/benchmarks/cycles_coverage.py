"""How often the 95 % intervals of `fit` hold the truth where the tissue was loaded four times.

    python -m tests.benchmarks.cycles_coverage --seeds 20 --out cycles.jsonl

A block of tet10 in a case folder of its own, its levels simulated on another mesh. The first loading is
stiffer, the second less so, from the third on the tissue repeats itself; what stays after a cycle moves the
touch of the next. `fit` as it is called by default: the last loading. Seeds already in the file are skipped.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from functools import partial
from pathlib import Path

import numpy as np

from limbcli.case import Case
from limbcli.feb.settings import schedule
from limbcli.measurement.repeated_loading import study_cycles
from limbcli.site_model.indentation_model import indentation_model
from limbcli.site_model.site_levels import all_levels_of
from limbcli.solvers.session import ReferenceSession
from limbcli.stages.build_feb import build_feb
from limbcli.stages.fit import FitOptions, fit
from tests.benchmarks.seeded_rows import counted, held, made, succeeded
from tests.stages import block_case as block

C, F_KAPPA, M = 0.008, 20.0, 4.0  # MPa
TRUE_CELLS = (10, 7, 4)
DEPTHS = np.linspace(0.6, 4.2, 7)
CYCLES = ((1.5, 0.0), (1.2, 0.4), (1.0, 0.6), (1.0, 0.6))  # times as stiff; mm that stayed before
FORCE_SD, DEPTH_SD, SPEED_SD = 0.05, 0.1, 0.05  # N, mm as the case states them; share of the speed
SWE_PIXELS = 100


def true_forces():
    model = indentation_model(
        block.block_model("tet10", counts=TRUE_CELLS), schedule(list(DEPTHS)), c=C, f_kappa=F_KAPPA, m=M
    )
    session = ReferenceSession(model)
    try:
        return session.solve().must_points.forces
    finally:
        session.close()


def rows_of(forces, rng):
    """levels.csv with noise: all loadings, each with its way back."""
    lines = ["cycle,phase,force_n,depth_mm,swe_mean_m_per_s,swe_sd_m_per_s,swe_pixels"]

    def row(cycle, phase, force, depth, speed=""):
        force = force + FORCE_SD * rng.standard_normal() * (force > 0)
        lines.append(f"{cycle},{phase},{max(force, 0.0):.6f},{depth:.6f},{speed}")

    for cycle, (gain, left) in enumerate(CYCLES, 1):
        speed = np.sqrt(gain * C * 1e6 / 2 / 1000.0) * (1 + SPEED_SD * rng.standard_normal())
        row(cycle, "load", 0.0, left, f"{speed:.6f},{SPEED_SD * speed:.6f},{SWE_PIXELS}")
        pairs = list(zip(DEPTHS + left, gain * forces, strict=True))
        for depth, force in pairs:
            row(cycle, "load", force, depth + DEPTH_SD * rng.standard_normal(), ",,")
        for depth, force in pairs[-2::-1]:
            row(cycle, "unload", 0.8 * force, depth + DEPTH_SD * rng.standard_normal(), ",,")
    return lines


def one_seed(seed, forces):
    rng = np.random.default_rng(seed)
    with tempfile.TemporaryDirectory() as folder:
        case_folder, out = Path(folder) / "case", Path(folder) / "out"
        block.make_case(case_folder, out, DEPTHS, forces, c=C, element="tet10", build=False)
        (case_folder / "levels.csv").write_text("\n".join(rows_of(forces, rng)) + "\n")
        case = Case.open(case_folder)
        build_feb(case, out=out)
        clock = time.process_time()
        data = fit(case, out=out, options=FitOptions(contact_check=False, boundary_check=False))[0].data
        levels = all_levels_of(case.site("p1"))
    study = study_cycles(levels, force_deviation=FORCE_SD, depth_deviation=DEPTH_SD)
    row = {"cpu_s": time.process_time() - clock, "repeats_from": study.repeats_from}
    for name, truth in (("c_kpa", 1e3 * C), ("f_kappa", F_KAPPA), ("m", M)):
        low, high = data["interval_95"][name] or (None, None)
        inside = (low is None or low <= truth) and (high is None or truth <= high)
        row |= {name: data[name], f"{name}_low": low, f"{name}_high": high, f"{name}_covered": inside}
    return row


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--out", type=Path, default=Path("cycles-coverage.jsonl"))
    given = parser.parse_args()
    one = partial(one_seed, forces=true_forces())
    rows = made(given.out, {(seed,): seed for seed in range(given.seeds)}, one)
    print(counted(rows))
    print("repeats itself from:", sorted(str(row["repeats_from"]) for row in succeeded(rows)))
    print(*(held(rows, name) for name in ("c_kpa", "f_kappa", "m")), sep="\n")


if __name__ == "__main__":
    main()
