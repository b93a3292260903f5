"""How often the joint fit's 95 % intervals hold the truth, made on one mesh and fitted on another.

    python -m tests.benchmarks.joint_coverage FIT.npz TRUTH.npz --seeds 100 --out joint.jsonl

Both are a site's mesh as `limbcli mesh` leaves it. The simulated levels lie at fixed
depths, so all seeds share the simulations; a seed costs its own fit on the surrogates
and now and then one simulation more. Seeds already in the file are skipped.
"""

from __future__ import annotations

import argparse
import sys
import time
from functools import partial
from pathlib import Path

import numpy as np

from limbcli.feb.settings import schedule
from limbcli.fitting.force_curves import LawCurve
from limbcli.fitting.laws import LAWS
from limbcli.fitting.numerical_error import gain_deviation
from limbcli.inference.joint_fit import JointTask, joint_fit
from limbcli.inference.monotone_interpolation import pchip_inverse, pchip_sample
from limbcli.inference.prediction import SolvedPoints
from limbcli.inference.site_depth import SiteMeasurement
from limbcli.model.npz_file import load_model
from limbcli.numbers.units import mpa_from_kpa
from limbcli.site_model.indentation_model import indentation_model
from tests.benchmarks.seeded_rows import counted, held, made

FORCE_SD, DEPTH_SD, SPEED_SD, DENSITY = 0.1, 0.3, 0.05, 1000.0


def law_curve(model, c, depths):
    loaded = indentation_model(model, schedule(list(depths)), c=c, f_kappa=100.0, m=2.0)
    return LawCurve(loaded, LAWS["ogden"], c=c, density_kg_per_m3=DENSITY)


def true_curves(model, truth, max_depth_mm, forces):
    """Depth and ln speed at the protocol's forces, by the truth's mesh."""
    knots = np.linspace(0.5, max_depth_mm, round(max_depth_mm / 0.5))
    curve = law_curve(model, truth["c"], knots)
    answer = curve(np.array([truth["f_kappa"], truth["m"]]), (0, 1)).values
    curve.close()
    force, speed = np.r_[0.0, answer[: len(knots)]], np.log(answer[len(knots) :])
    forces = forces[forces < force[-1]]
    depth = pchip_inverse(np.r_[0.0, knots], force, forces)
    rest = 0.5 * np.log(truth["c"] * 1e6 / 2 / DENSITY)
    return forces, depth, pchip_sample(np.r_[0.0, knots], np.r_[rest, speed], depth).values


def one_seed(seed, memory, knots, truth, forces, depths, speeds, gain):
    rng = np.random.default_rng(seed)
    force = forces + FORCE_SD * rng.standard_normal(len(forces)) * (forces > 0)
    depth = depths + DEPTH_SD * rng.standard_normal(len(forces)) * (forces > 0)
    speed = speeds + SPEED_SD * rng.standard_normal(len(forces))
    loaded = (depth > 0) & (force > 0)
    data = SiteMeasurement(
        "site", knots, force[loaded], depth[loaded], FORCE_SD, DEPTH_SD, np.maximum(force, 0.0), speed,
        np.full(len(speed), SPEED_SD), gain,
    )  # fmt: skip
    c0 = truth["c"]
    task = JointTask([memory], [data], LAWS["ogden"].shape, c0, [0.5 * np.log(c0 * 1e6 / 2 / DENSITY)])
    starts = [np.array([c0, 100.0, 2.0]), np.array([c0, 10.0, 4.0])]
    before, clock = memory.n_solves, time.process_time()
    _, found = joint_fit(task, starts, max_solves=6)
    row = {"n_solves": memory.n_solves - before, "cpu_s": time.process_time() - clock}
    for k, (name, profile) in enumerate(found.profiles.items()):
        row[name] = float(found.best[k])
        row[f"{name}_low"], row[f"{name}_high"] = profile.low, profile.high
        row[f"{name}_covered"] = bool(profile.low <= truth[name] <= profile.high)
    return row


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("model", type=Path)
    parser.add_argument("truth_model", type=Path)
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--out", type=Path, default=Path("joint-coverage.jsonl"))
    parser.add_argument("--c-kpa", type=float, default=8.0)
    parser.add_argument("--f-kappa", type=float, default=50.0)
    parser.add_argument("--m", type=float, default=6.0)
    parser.add_argument("--step-n", type=float, default=2.0)
    parser.add_argument("--max-force-n", type=float, default=24.0)
    parser.add_argument("--max-depth-mm", type=float, default=15.0)
    given = parser.parse_args()
    truth = {"c": mpa_from_kpa(given.c_kpa), "f_kappa": given.f_kappa, "m": given.m}
    wanted = np.arange(0.0, given.max_force_n + 1e-9, given.step_n)
    forces, depths, speeds = true_curves(load_model(given.truth_model), truth, given.max_depth_mm, wanted)
    print(f"{len(forces)} levels to {forces[-1]:g} N at {depths[-1]:.2f} mm", file=sys.stderr)
    model = load_model(given.model)
    curve = law_curve(model, truth["c"], np.linspace(0.08, 1.1, 9) * depths[-1])
    memory = SolvedPoints(curve)
    for shape in ((100.0, 2.0), (10.0, 2.0), (100.0, 4.0)):
        memory(np.array(shape), (0, 1))
    one = partial(
        one_seed, memory=memory, knots=curve.depths, truth=truth, forces=forces, depths=depths, speeds=speeds,
        gain=gain_deviation(model, None),
    )  # fmt: skip
    rows = made(given.out, {(seed,): seed for seed in range(given.seeds)}, one)
    print(f"{counted(rows)}; {memory.n_solves} simulations")
    print(*(held(rows, name) for name in ("c", "f_kappa", "m")), sep="\n")


if __name__ == "__main__":
    main()
