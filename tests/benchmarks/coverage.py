"""How often the 95 % intervals of `fit` hold the truth, and what an identification costs.

    python -m tests.benchmarks.coverage MODEL.npz --seeds 20 --out coverage.jsonl
        [--truth-model OTHER.npz] [--element tet4] [--gain-deviation 0] [--c-kpa 8 --f-kappa 100 --m 6]

MODEL.npz is a site's mesh as `limbcli mesh` leaves it. A measurement is simulated on
it (or on another mesh), noise is added seed by seed, and `fit`'s own functions identify
the parameters. One line of JSON a seed; seeds already in the file are skipped, so a run
can be interrupted and taken up again.
"""

from __future__ import annotations

import argparse
import sys
import time
from functools import partial
from pathlib import Path

import numpy as np

from limbcli.feb.settings import LEAST_START, schedule
from limbcli.fitting.force_curves import ReferenceCurve
from limbcli.fitting.numerical_error import gain_deviation
from limbcli.inference.prediction import SolvedPoints
from limbcli.inference.profile_intervals import Stiffness, force_intervals
from limbcli.inference.two_step_fit import CurveMatch, ForceDepth, two_step
from limbcli.meshing.elements import with_element
from limbcli.model.npz_file import load_model
from limbcli.numbers.units import mpa_from_kpa
from limbcli.phantom.protocol import depth_at_force
from limbcli.site_model.indentation_model import indentation_model
from limbcli.solvers.session import ReferenceSession
from limbcli.stages.fit import START
from tests.benchmarks.seeded_rows import counted, held, made, succeeded

FORCE_SD, DEPTH_SD, SPEED_SD = 0.1, 0.3, 0.05


def true_levels(model, *, c, f_kappa, m, step_n, max_force_n, max_depth_mm):
    """Forces and depths of the levels, without noise."""
    grid = np.arange(0.5, max_depth_mm + 1e-9, 0.5)
    session = ReferenceSession(indentation_model(model, schedule(list(grid)), c=c, f_kappa=f_kappa, m=m))
    points = session.solve().must_points
    session.close()
    depth, force = np.r_[0.0, points.depths], np.r_[0.0, points.forces]
    forces = np.arange(0.0, min(max_force_n, force[-1]) + 1e-9, step_n)
    return forces, depth_at_force(depth, force, forces)


def one_seed(seed, model, truth, forces, depths, gain):
    """Measure with noise, identify, and see whether the intervals hold the truth."""
    rng = np.random.default_rng(seed)
    first = np.arange(len(forces)) == 0
    force = forces + np.where(first, 0.0, FORCE_SD * rng.standard_normal(len(forces)))
    depth = depths + np.where(first, 0.0, DEPTH_SD * rng.standard_normal(len(forces)))
    c = truth["c"] * (1 + SPEED_SD * rng.standard_normal()) ** 2
    data = ForceDepth(force, depth, FORCE_SD, DEPTH_SD)
    simulated = np.unique(depth[depth > LEAST_START])
    start = indentation_model(model, schedule(list(simulated)), c=c, f_kappa=100.0, m=2.0)
    clock, work = time.perf_counter(), time.process_time()
    curve = ReferenceCurve(start, c=c)
    memory = SolvedPoints(curve)
    memory(START, (0, 1))
    cold, cold_work = time.perf_counter() - clock, time.process_time() - work
    steps = two_step(CurveMatch(memory, curve.depths, data))
    identified, fit_work = time.perf_counter() - clock, time.process_time() - work
    n_fit = memory.n_solves
    stiffness = Stiffness(c, 2 * SPEED_SD, gain_deviation(model, gain, f_kappa=float(steps[-1].theta[0])))
    found = force_intervals(CurveMatch(memory, curve.depths, data), stiffness, steps[-1].theta)
    curve.close()
    row = {
        "c_kpa": 1e3 * c, "f_kappa": steps[-1].theta[0], "m": steps[-1].theta[1],
        "r2": steps[-1].r2, "n_solves": n_fit, "n_interval_solves": found.n_solves, "cold_s": cold,
        "identification_s": identified, "cold_cpu_s": cold_work,
        "identification_cpu_s": fit_work, "total_s": time.perf_counter() - clock, "scale": found.scale,
        "unsolved": len(found.unsolved),
    }  # fmt: skip
    for name, profile in found.profiles.items():
        row[f"{name}_low"], row[f"{name}_high"] = profile.low, profile.high
        row[f"{name}_open"] = [profile.open_low, profile.open_high]
        row[f"{name}_covered"] = bool(profile.low <= truth[name] <= profile.high)
    return row


def summary(rows):
    """The figures that matter."""
    good, lines = succeeded(rows), [counted(rows)]
    for name in ("f_kappa", "m"):
        open_ends = np.mean([row[f"{name}_open"] for row in good], axis=0)
        lines.append(
            f"{held(rows, name)}, open low {100 * open_ends[0]:.0f} %, open high {100 * open_ends[1]:.0f} %"
        )
    ratio = [row["identification_cpu_s"] / row["cold_cpu_s"] for row in good]
    keys = ("n_solves", "n_interval_solves", "cold_cpu_s")
    middle = {key: np.median([row[key] for row in good]) for key in keys}
    lines.append(
        f"identification over one cold solve, processor time: median {np.median(ratio):.2f}, "
        f"worst {max(ratio):.2f}"
    )
    lines.append(
        f"solves: median {middle['n_solves']:g}, intervals add {middle['n_interval_solves']:g}; "
        f"a cold solve takes {middle['cold_cpu_s']:.2f} s"
    )
    return "\n".join(lines)


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("model", type=Path)
    parser.add_argument("--truth-model", type=Path)
    parser.add_argument("--element", help="of the fit's mesh, and of the truth's")
    parser.add_argument("--truth-element", help="of the truth's mesh, where it is another")
    parser.add_argument("--gain-deviation", type=float, help="numerical error allowed for, relative")
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--out", type=Path, default=Path("coverage.jsonl"))
    parser.add_argument("--c-kpa", type=float, default=8.0)
    parser.add_argument("--f-kappa", type=float, default=100.0)
    parser.add_argument("--m", type=float, default=6.0)
    parser.add_argument("--step-n", type=float, default=2.0)
    parser.add_argument("--max-force-n", type=float, default=24.0)
    parser.add_argument("--max-depth-mm", type=float, default=15.0)
    given = parser.parse_args()
    model = load_model(given.model)
    model = with_element(model, given.element) if given.element else model
    truth = {"c": mpa_from_kpa(given.c_kpa), "f_kappa": given.f_kappa, "m": given.m}
    other = load_model(given.truth_model) if given.truth_model else model
    truth_element = given.truth_element or given.element
    other = with_element(other, truth_element) if truth_element else other
    forces, depths = true_levels(
        other, **truth, step_n=given.step_n, max_force_n=given.max_force_n, max_depth_mm=given.max_depth_mm
    )
    print(f"{len(forces)} levels to {forces[-1]:g} N at {depths[-1]:.2f} mm", file=sys.stderr)
    one = partial(one_seed, model=model, truth=truth, forces=forces, depths=depths, gain=given.gain_deviation)
    print(summary(made(given.out, {(seed,): seed for seed in range(given.seeds)}, one)))


if __name__ == "__main__":
    main()
