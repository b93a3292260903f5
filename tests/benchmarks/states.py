"""How often the 95 % intervals of a fit of three states hold the truth, made on one mesh and fitted on
another.

    python -m tests.benchmarks.states FIT.npz TRUTH.npz --seeds 20 --out states.jsonl
    python -m tests.benchmarks.states --case cases/states --element tet10 --size-mm 5 3 --out states10.jsonl
    python -m tests.benchmarks.states FIT.npz TRUTH.npz --write cases/states

Both are a site's mesh as `limbcli mesh` leaves it, the probe along the limb; or `--case` names a case whose
first site is meshed twice (edges under the probe: of the fit's mesh, of the truth's). The levels lie at fixed
forces, so all seeds share the simulations; a seed costs its own fit on the surrogate and some simulations
more. Seeds already in the file are skipped. `--write` leaves the levels of seed 7 as a case's files instead.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from functools import partial
from pathlib import Path

import numpy as np

from limbcli.case import Case
from limbcli.feb.settings import schedule
from limbcli.fitting.laws import LAWS
from limbcli.fitting.numerical_error import gain_deviation
from limbcli.fitting.state_curve import StateCurve
from limbcli.fitting.state_plan import plan_of
from limbcli.inference.derived import derived_interval, lowest_on_grid
from limbcli.inference.joint_fit import JointTask, joint_fit
from limbcli.inference.monotone_interpolation import pchip_inverse, pchip_sample
from limbcli.inference.prediction import SolvedPoints
from limbcli.inference.site_depth import SiteMeasurement
from limbcli.model.npz_file import load_model
from limbcli.numbers.units import mpa_from_kpa
from limbcli.site_model.indentation_model import indentation_model
from limbcli.stages.fit_states import first_simulations, knots_to, starts
from limbcli.stages.mesh import MeshRequest, mesh
from limbcli.stages.segment import segment
from tests.benchmarks.seeded_rows import counted, held, made, succeeded

FORCE_SD, DEPTH_SD, SPEED_SD, DENSITY = 0.05, 0.2, 0.03, 1000.0
GRID = np.linspace(np.log(0.35), np.log(1.8), 241)


def state_curve(model, law, c, depths):
    loaded = indentation_model(model, schedule([1.0, 2.0]), c=c, f_kappa=100.0, m=2.0)
    return StateCurve(loaded, LAWS[law], ("along",), depths, c=c, density_kg_per_m3=DENSITY)


def true_levels(model, truth, given, forces, max_depth_mm):
    """Depth (mm) and speed (m/s) of each state at the protocol's forces, by the truth's mesh."""
    curve = state_curve(model, "ogden", truth["c"], np.linspace(0.5, max_depth_mm, 12))
    found = []
    for each in given:
        theta = np.array([truth["f_kappa"], truth["m"], each / truth["unloaded_stretch_along"]])
        values, n = curve(theta).values, len(curve.depths)
        depths = np.r_[0.0, curve.depths]
        if values[n - 1] < forces[-1]:
            sys.exit(
                f"the truth reaches {values[n - 1]:.2f} N at {max_depth_mm:g} mm in the state {each:g}, not "
                f"{forces[-1]:.2f} N: give a larger --max-depth-mm, or a smaller --max-force-n"
            )
        at = pchip_inverse(depths, np.r_[0.0, values[:n]], forces)
        logs = np.log(np.r_[values[2 * n], values[n : 2 * n]]) + curve.even_speed(theta)[0]
        found.append((at, np.exp(pchip_sample(depths, logs, at).values)))
    lowest = lowest_on_grid(GRID, curve.even_speeds(theta[:2], np.exp(GRID)[:, None]))
    curve.close()
    return found, float(np.exp(lowest)) * truth["unloaded_stretch_along"]


def noisy(levels, forces, seed):
    rng, found = np.random.default_rng(seed), []
    for depth, speed in levels:
        loaded = forces > 0
        force = forces + FORCE_SD * rng.standard_normal(len(forces)) * loaded
        read = np.maximum(depth + DEPTH_SD * rng.standard_normal(len(forces)) * loaded, 0.0)
        found.append((force, read, speed * np.exp(SPEED_SD * rng.standard_normal(len(forces)))))
    return found


def one_seed(seed, memory, curve, plan, levels, forces, truth, gain):
    several = []
    for k, (force, depth, speed) in enumerate(noisy(levels, forces, seed)):
        loaded = (depth > 0) & (force > 0)
        several.append(SiteMeasurement(
            str(k), curve.depths, force[loaded], depth[loaded], FORCE_SD, DEPTH_SD, np.maximum(force, 0.0),
            np.log(speed), np.full(len(speed), SPEED_SD), gain,
        ))  # fmt: skip
    law, clock, before = LAWS["ogden"], time.process_time(), memory.n_solves
    task = JointTask(
        [memory] * len(several), several, law.shape, truth["c"], states=plan, even_speed=curve.even_speed
    )
    problem, found = joint_fit(task, starts(truth["c"], law, plan), max_solves=3)

    def lowest(theta):
        speeds = curve.even_speeds(theta[1:3], np.exp(GRID)[:, None])
        return lowest_on_grid(GRID, speeds) + float(np.log(theta[3]))

    least = derived_interval(
        problem.objective(), problem.parameters, found.fit, lowest, -1.5, 0.7, 0.04,
        scale=found.scale, threshold=found.threshold,
    )  # fmt: skip
    row = {"n_solves": memory.n_solves - before, "cpu_s": time.process_time() - clock}
    row |= {"chi_square": found.chi_square, "n_freedom": found.n_freedom}
    for k, (name, profile) in enumerate(found.profiles.items()):
        row |= {name: float(found.best[k]), f"{name}_low": profile.low, f"{name}_high": profile.high}
        above, below = profile.low <= truth[name], truth[name] <= profile.high
        row[f"{name}_covered"] = bool((above or profile.open_low) and (below or profile.open_high))
    low, high = np.exp([least.low, least.high])
    row |= {"lowest": float(np.exp(least.value)), "lowest_low": low, "lowest_high": high}
    above, below = low <= truth["lowest"], truth["lowest"] <= high
    row["lowest_covered"] = bool((above or least.open_low) and (below or least.open_high))
    row["lowest_told"] = not (least.open_low or least.open_high)
    return row


def write_case(folder, levels, forces, names):
    for name, (force, depth, speed) in zip(names, noisy(levels, forces, 7), strict=True):
        rows = ["force_n,depth_mm,swe_mean_m_per_s"]
        table = zip(np.maximum(force, 0.0), depth, speed, strict=True)
        rows += [f"{f:.2f},{d:.2f},{v:.3f}" for f, d, v in table]
        (folder / name).mkdir(parents=True, exist_ok=True)
        (folder / name / "levels.csv").write_text("\n".join(rows) + "\n")


def meshed(case_folder, element, sizes):
    """Models of a case's first site, one for each edge length under the probe (mm)."""
    case, models = Case.open(case_folder), []
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder)
        segment(case, out=out)
        for size in sizes:
            place = mesh(
                case, out=out, sites=[case.sites[0].name], options=MeshRequest(element=element, size=size)
            )[0].folder
            models.append(load_model(place / "model.npz"))
    return models


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("models", type=Path, nargs="*", help="FIT.npz TRUTH.npz; none with --case")
    parser.add_argument("--case", type=Path, help="is meshed for both, instead")
    parser.add_argument("--element", choices=("tet4", "tet10"), help="with --case; default: the case's")
    parser.add_argument("--size-mm", type=float, nargs=2, default=[5.0, 3.0], help="with --case: fit, truth")
    parser.add_argument("--max-minutes", type=float, default=np.inf, help="no seed is begun after it")
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--out", type=Path, default=Path("states-coverage.jsonl"))
    parser.add_argument("--write", type=Path, help="a case folder for the levels of seed 7")
    parser.add_argument("--c-kpa", type=float, default=6.0)
    parser.add_argument("--f-kappa", type=float, default=10.0)
    parser.add_argument("--m", type=float, default=6.0)
    parser.add_argument("--unloaded", type=float, default=0.95)
    parser.add_argument("--told", type=float, nargs="+", default=[0.72, 0.9, 1.1])
    parser.add_argument("--step-n", type=float, default=0.7)
    parser.add_argument("--max-force-n", type=float, default=5.0)
    parser.add_argument("--max-depth-mm", type=float, default=5.0)
    given = parser.parse_args()
    truth = {
        "c": mpa_from_kpa(given.c_kpa), "f_kappa": given.f_kappa, "m": given.m,
        "unloaded_stretch_along": given.unloaded,
    }  # fmt: skip
    forces = np.arange(0.0, given.max_force_n + 1e-9, given.step_n)
    if (given.case is None) == (len(given.models) != 2):
        parser.error("give FIT.npz and TRUTH.npz, or --case")
    ends = time.monotonic() + 60 * given.max_minutes
    pair = [load_model(path) for path in given.models] or meshed(given.case, given.element, given.size_mm)
    model, truth_model = pair
    blocks = [each.mesh.solid_blocks[0] for each in pair]
    print("fit, truth:", *(f"{len(each.cells)} {each.kind}" for each in blocks), file=sys.stderr)
    levels, truth["lowest"] = true_levels(truth_model, truth, given.told, forces, given.max_depth_mm)
    deepest = max(depth[-1] for depth, _ in levels)
    print(f"to {deepest:.2f} mm; speed least at {truth['lowest']:.3f}", file=sys.stderr)
    if given.write is not None:
        write_case(given.write, levels, forces, ("bent", "middle", "straight")[: len(levels)])
        return
    curve = state_curve(model, "ogden", truth["c"], knots_to(deepest))
    plan = plan_of({"along": given.told}, {}, [str(k) for k in range(len(levels))])
    memory = SolvedPoints(curve)
    first_simulations(memory, LAWS["ogden"], plan)
    one = partial(
        one_seed, memory=memory, curve=curve, plan=plan, levels=levels, forces=forces, truth=truth,
        gain=gain_deviation(model, None),
    )  # fmt: skip
    rows = made(given.out, {(seed,): seed for seed in range(given.seeds)}, one, until=ends)
    print(f"{counted(rows)}; {memory.n_solves} simulations")
    for name, value in truth.items():
        width = np.median([row[f"{name}_high"] / row[f"{name}_low"] for row in succeeded(rows)])
        print(f"{held(rows, name)} (true {value:.4g}), upper over lower end {width:.3g}")


if __name__ == "__main__":
    main()
