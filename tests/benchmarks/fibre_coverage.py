"""How often the 95 % intervals of a fit with fibres hold the truth: two orientations, made on another mesh.

    python -m tests.benchmarks.fibre_coverage --seeds 20 --out fibres.jsonl

Blocks of tet10, pressed across and along the fibres. The simulated levels lie at fixed depths, so all seeds
share the simulations; a seed costs its own fit, and a few simulations more. Seeds already in the file are
skipped.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from limbcli.feb.settings import schedule
from limbcli.fitting.fibres import rest_speed
from limbcli.fitting.force_curves import LawCurve
from limbcli.fitting.laws import LAWS, first_shapes
from limbcli.inference.joint_fit import JointTask, joint_fit
from limbcli.inference.monotone_interpolation import pchip_inverse, pchip_sample
from limbcli.inference.prediction import SolvedPoints
from limbcli.inference.site_depth import SiteMeasurement
from limbcli.model import ElementMap
from limbcli.site_model.indentation_model import indentation_model
from tests.benchmarks.seeded_rows import counted, held, made, succeeded
from tests.stages.block_case import block_model

C = 0.006  # MPa
TRUTH = {"c": C, "m": 3.0, "fibre_shear": 1.0, "fibre_tension": 0.5}
ALONG = {"across": (0.0, 1.0, 0.0), "along": (1.0, 0.0, 0.0)}  # the fibres in each probe's frame
FIT_CELLS, TRUE_CELLS = (6, 5, 3), (7, 6, 3)
DEEPEST_MM, LEVELS = 4.2, 8
FORCE_SD, DEPTH_SD, SPEED_SD, GAIN = 0.05, 0.1, 0.05, 0.08
DENSITY, LAW = 1000.0, LAWS["fibres"]


def built(axis, cells, depths):
    model = block_model("tet10", counts=cells)
    n = len(model.mesh.block("tissue").cells)
    fibred = replace(model, fibres=ElementMap("fibres", "tissue", np.tile(np.array(axis), (n, 1))))
    return indentation_model(fibred, schedule(list(depths)), c=C, f_kappa=100.0, m=2.0)


def curve_of(axis, cells, depths):
    return LawCurve(built(axis, cells, depths), LAW.along(axis), c=C, density_kg_per_m3=DENSITY)


def rest_of(axis, cells):
    model = built(axis, cells, [1.0, 2.0])
    return rest_speed(model, LAW.along(axis), c=C, density_kg_per_m3=DENSITY)


def true_levels(axis):
    """Forces (N), depths (mm) and ln speeds of the levels, by the truth's mesh."""
    knots = np.linspace(0.6, DEEPEST_MM, 7)
    shape = np.array([TRUTH[each.name] for each in LAW.shape])
    curve = curve_of(axis, TRUE_CELLS, knots)
    forces, speeds = np.split(curve(shape).values, 2)
    curve.close()
    rest = rest_of(axis, TRUE_CELLS)(shape)[0]
    levels = np.linspace(0.0, forces[-1], LEVELS)
    depth = pchip_inverse(np.r_[0.0, knots], np.r_[0.0, forces], levels)
    return levels, depth, pchip_sample(np.r_[0.0, knots], np.r_[rest, np.log(speeds)], depth).values


def measured(name, knots, true, rng):
    forces, depths, speeds = true
    force = forces + FORCE_SD * rng.standard_normal(LEVELS) * (forces > 0)
    depth = depths + DEPTH_SD * rng.standard_normal(LEVELS) * (forces > 0)
    speed = speeds + SPEED_SD * rng.standard_normal(LEVELS)
    loaded = (depth > 0) & (force > 0)
    return SiteMeasurement(
        name, knots, force[loaded], depth[loaded], FORCE_SD, DEPTH_SD, np.maximum(force, 0.0), speed,
        np.full(LEVELS, SPEED_SD), GAIN,
    )  # fmt: skip


def one_seed(seed, memories, knots, true, rests):
    rng = np.random.default_rng(seed)
    data = [measured(name, knots, true[name], rng) for name in ALONG]
    task = JointTask(memories, data, LAW.shape, C, rests)
    clock, before = time.process_time(), sum(each.n_solves for each in memories)
    _, found = joint_fit(task, [np.r_[C, shape] for shape in first_shapes(LAW)], max_solves=6)
    row = {"cpu_s": time.process_time() - clock}
    row["n_solves"] = sum(each.n_solves for each in memories) - before
    for k, (name, profile) in enumerate(found.profiles.items()):
        row[name], row[f"{name}_low"], row[f"{name}_high"] = float(found.best[k]), profile.low, profile.high
        low = -np.inf if profile.low is None else profile.low
        high = np.inf if profile.high is None else profile.high
        row[f"{name}_covered"] = bool(low <= TRUTH[name] <= high)
    return row


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--out", type=Path, default=Path("fibre-coverage.jsonl"))
    given = parser.parse_args()
    true = {name: true_levels(axis) for name, axis in ALONG.items()}
    knots = np.linspace(0.6, 1.1 * DEEPEST_MM, 8)
    memories, rests = [], []
    for axis in ALONG.values():
        memory = SolvedPoints(curve_of(axis, FIT_CELLS, knots))
        for shape in first_shapes(LAW):
            memory(shape, tuple(range(len(shape))))
        memories.append(memory)
        rests.append(rest_of(axis, FIT_CELLS))
    one = partial(one_seed, memories=memories, knots=knots, true=true, rests=rests)
    rows = made(given.out, {(seed,): seed for seed in range(given.seeds)}, one)
    good = succeeded(rows)
    print(f"{counted(rows)}, {sum(row['n_solves'] for row in good)} more solves")
    for name in TRUTH:
        low, high = (np.median([_number(row[f"{name}_{end}"]) for row in good]) for end in ("low", "high"))
        print(f"{held(rows, name)}, typically {low:.4g} to {high:.4g}")


def _number(end):
    """NaN where the data leave an end open."""
    return np.nan if end is None else end


if __name__ == "__main__":
    main()
