"""A block of biphasic tissue that FEBio measured: its model along the whole protocol, no superposition."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from limbcli.case import Case
from limbcli.diagnosis.curves.site_simulations import SiteSimulations
from limbcli.effects import poroelasticity
from limbcli.feb.settings import schedule
from limbcli.model import Array, Curve, LimbModel
from limbcli.model.npz_file import save_model
from limbcli.progress import SILENT
from limbcli.results import open_stage
from limbcli.site_model.indentation_model import TRAVEL, indentation_model
from limbcli.solvers.febio import FebioSolver
from tests.stages import block_case as block

START, RAMP_S = 0.1, 1.0
NOISE_N, NOISE_MM = 0.01, 0.01


@dataclass(frozen=True)
class Staircase:
    """depths mm, each reached in a ramp of 1 s and held for `hold` s; c MPa; k mm^4/(N s)."""

    depths: tuple[float, ...]
    hold: float = 12.0
    c: float = 0.03
    m: float = 3.0
    k: float = 15.0
    steps_of_hold: int = 7

    def model(self, meshed: LimbModel) -> LimbModel:
        """Of FEBio, in seconds."""
        loaded = schedule(list(self.depths), start=START)
        model = indentation_model(meshed, loaded, c=self.c, f_kappa=100.0, m=self.m)
        theta = {**poroelasticity.with_permeability(self.k), poroelasticity.DRAINED: 2.0}
        biphasic = poroelasticity.apply(model, theta)
        times, travel = [], [(0.0, 0.0)]
        for n, depth in enumerate(self.depths):
            from_, to = n * (RAMP_S + self.hold), n * (RAMP_S + self.hold) + RAMP_S
            times += [from_ + 0.5 * RAMP_S, to]
            times += (
                to + self.hold * 2.0 ** (np.arange(self.steps_of_hold) - self.steps_of_hold + 1)
            ).tolist()
            travel += [(to, depth - START), (to + self.hold, depth - START)]
        times = [float(f"{each:.5f}") for each in times]
        largest = np.diff(times, prepend=0.0) * 1.01
        points = tuple(zip([0.0, *times], [*largest.tolist(), float(largest[-1])], strict=True))
        least, end = float(largest.min()), times[-1]
        n_steps = int(np.ceil(end / least))
        step = replace(
            biphasic.steps[0], n_steps=n_steps, step_size=end / n_steps, dt_min=least / 200, must_points=(),
            dt_max_curve="steps",
        )  # fmt: skip
        curves = {TRAVEL: Curve(tuple(travel)), "steps": Curve(points, interpolate="step")}
        return replace(biphasic, curves=curves, steps=(step,), records=biphasic.records[:1])

    def by_febio(self, meshed: LimbModel, folder: Path, binary: Path | None = None) -> tuple[Array, Array]:
        """Times (n,) s and forces (n,) N of every step."""
        solver = FebioSolver(binary, threads=1)
        folder.mkdir(parents=True, exist_ok=True)
        feb = solver.write(self.model(meshed), folder)
        solver.run(feb, progress=SILENT)
        found = solver.read(feb)
        return np.r_[0.0, found.times], np.r_[0.0, found.probe_force()]

    def depth_at(self, time: Array) -> Array:
        ends = [n * (RAMP_S + self.hold) for n in range(len(self.depths) + 1)]
        at = [0.0, *(each for n in ends[:-1] for each in (n + RAMP_S, n + RAMP_S + self.hold))]
        return np.interp(time, at, [0.0, *np.repeat(self.depths, 2)])


def speeds(meshed: LimbModel, stairs: Staircase) -> Array:
    """m/s (n_levels + 1,) of the skeleton at the levels, at rest first."""
    deep = stairs.depths[-1]
    simulations = SiteSimulations(meshed, [0.25 * deep, 0.5 * deep, 0.75 * deep, deep], c=stairs.c)
    try:
        curves = simulations.curves(stairs.m)
    finally:
        simulations.close()
    at = np.r_[0.0, stairs.depths]
    return np.exp(np.interp(at, curves.depth, curves.log_speed[:, 0]))


def make_case(
    folder: Path, out: Path, stairs: Staircase, time: Array, force: Array, speed: Array, working: LimbModel,
    rng: np.random.Generator,
) -> Case:  # fmt: skip
    """The readings with noise; `working` is the mesh that the case is diagnosed on."""
    folder.mkdir(parents=True)
    for name in ("skin.stl", "bone.stl"):
        (folder / name).write_text("solid\nendsolid\n")
    toml = block.CASE_TOML.replace('"assumed"', '"spec"').replace("depth_mm = 0.1", "depth_mm = 0.05")
    (folder / "case.toml").write_text(
        toml.replace('levels = "levels.csv"', 'levels = "levels.csv"\ntrace = "trace.csv"')
    )
    at = np.arange(0.0, time[-1], 0.1)
    shown = np.interp(at, time, force) + NOISE_N * rng.standard_normal(len(at))
    depth = stairs.depth_at(at) + NOISE_MM * rng.standard_normal(len(at))
    rows = [f"{t:.2f},{f:.4f},{d:.4f}" for t, f, d in zip(at, shown, depth, strict=True)]
    (folder / "trace.csv").write_text("time_s,force_n,depth_mm\n" + "\n".join(rows) + "\n")
    read_at = (np.arange(len(stairs.depths)) + 1) * (RAMP_S + stairs.hold)
    forces = np.interp(read_at, time, force) + 0.02 * rng.standard_normal(len(read_at))
    depths = np.array(stairs.depths) + 0.03 * rng.standard_normal(len(read_at))
    noisy = speed * (1 + 0.03 * rng.standard_normal(len(speed)))
    table = [(0.0, 0.0, noisy[0]), *zip(forces, depths, noisy[1:], strict=True)]
    lines = [f"{f:.4f},{d:.4f},{v:.4f},500,{stairs.hold}" for f, d, v in table]
    header = "force_n,depth_mm,swe_mean_m_per_s,swe_pixels,hold_s"
    (folder / "levels.csv").write_text("\n".join([header, *lines]) + "\n")
    with open_stage(out, "mesh", subject="B1", site="p1") as writer:
        save_model(working, writer.file("model", "model.npz"))
    return Case.open(folder)
