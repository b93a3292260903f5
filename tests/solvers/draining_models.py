"""What FEBio is asked about draining tissue: a column whose answer is known, a block's holds and staircases.

python -m tests.solvers.draining_models FEBIO     writes tests/data/febio-draining.json
"""

from __future__ import annotations

import json
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from limbcli.diagnosis.drainage import held_model, hold_of
from limbcli.effects import poroelasticity
from limbcli.materials.ogden import ogden_type
from limbcli.model import Array, Block, Curve, Domain, LimbModel, LogRecord, Mesh, Step, Support
from limbcli.progress import SILENT
from limbcli.solvers.febio import FebioSolver
from tests.stages.block_case import block_model
from tests.stages.draining_case import Staircase

FILE = Path(__file__).resolve().parents[1] / "data" / "febio-draining.json"
# A column 2 x 2 x 10 mm: confined, pressed by 0.05 % in 20 s, and held. MPa, mm^4/(N s).
HEIGHT, WIDTH, PRESSED, RAMP_S, END_S, C, K = 10.0, 2.0, 0.005, 20.0, 200.0, 0.01, 50.0
N_CELLS, STEP_S = 40, 0.5
HOLD_DEPTHS, HOLD_C, HOLD_M = (4.0, 2.0, 1.0), 0.006, 4.0
STAIRS = {rate: Staircase((1.0, 2.0, 3.0, 4.0), 20.0, HOLD_C, HOLD_M, rate / HOLD_C) for rate in (0.05, 0.5)}


def column() -> LimbModel:
    """Sides that do not move and let nothing through, a base likewise, a lid that is pressed and drains."""
    z = np.linspace(-HEIGHT, 0.0, N_CELLS + 1)
    corners = WIDTH * np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    points = np.concatenate([np.column_stack([corners, np.full(4, each)]) for each in z])
    cells = 4 * np.arange(N_CELLS)[:, None] + np.arange(8)
    every = np.arange(len(points))
    lid, base = every[-4:], every[:4]
    mesh = Mesh(points, (Block("tissue", "hex8", cells),), {"all": every, "lid": lid, "base": base})
    dry = LimbModel(
        mesh, {"tissue": ogden_type(c=C, f_kappa=100.0, m=2.0)}, (Domain("tissue", "tissue"),),
        supports=(
            Support("all", ("x", "y")), Support("base", ("z",)), Support("lid", ("p",)),
            Support("lid", ("z",), -PRESSED, "press"),
        ),
        curves={"press": Curve(((0.0, 0.0), (RAMP_S, 1.0), (END_S, 1.0)))},
        steps=(Step(round(END_S / STEP_S), STEP_S, adaptive=False, control={"dtol": 1e-4, "etol": 1e-4,
                    "symmetric_stiffness": "symmetric", "qn_method": "BFGS"}),),
        records=(LogRecord("node", ("Rz",), "lid.csv", lid),),
    )  # fmt: skip
    return poroelasticity.apply(dry, poroelasticity.with_permeability(K))


def closed_form(time: Array) -> Array:
    """N on the lid. Mow et al. 1980, J Biomech Eng 102:73: a ramp of a confined column, and its hold.

    sigma = H e_dot t + H e_dot 2 tau / pi^2 sum_n (1 - exp(-n^2 pi^2 t / tau)) / n^2, tau = h^2 / (H k), with
    H = lambda + 2 mu of the drained solid; after the ramp the same less itself, later.
    """
    H = 2.0 * C + C
    tau, rate = HEIGHT**2 / (H * K), PRESSED / HEIGHT / RAMP_S
    n2 = np.arange(1, 2000)[:, None] ** 2

    def ramp(t: Array) -> Array:
        late = np.sum(-np.expm1(-n2 * np.pi**2 * t / tau) / n2, axis=0)
        return H * rate * (t + 2.0 * tau / np.pi**2 * late)

    after = np.maximum(time - RAMP_S, 0.0)
    return WIDTH**2 * (ramp(time) - ramp(after))


def answers(binary: Path) -> dict[str, Any]:
    """Of FEBio to all of it."""
    with tempfile.TemporaryDirectory() as name:
        folder, solver = Path(name), FebioSolver(binary, threads=1)
        found: dict[str, Any] = {"column": column_by(solver, folder / "column"), "holds": [], "stairs": []}
        meshed = block_model("tet10", counts=(8, 6, 3))
        for depth in HOLD_DEPTHS:
            feb = solver.write(held_model(meshed, depth, c=HOLD_C, m=HOLD_M), folder / f"hold-{depth:g}")
            solver.run(feb, progress=SILENT)
            hold = hold_of(solver.read(feb), depth)
            steps = {"spread_mm2": hold.spread.tolist(), "force_n": hold.force.tolist()}
            found["holds"].append({"depth_mm": depth, "ramp_mm2": hold.ramp, **steps})
        for rate, stairs in STAIRS.items():
            time, force = stairs.by_febio(meshed, folder / f"stairs-{rate:g}", binary)
            found["stairs"].append(
                {"k_c_mm2_per_s": rate, "time_s": time.tolist(), "force_n": force.tolist()}
            )
    return {"febio": solver.version(), **found}


def column_by(solver: FebioSolver, folder: Path) -> dict[str, list[float]]:
    feb = solver.write(column(), folder)
    solver.run(feb, progress=SILENT)
    found = solver.read(feb)
    force = found.nodes["lid.csv"].column("Rz").sum(axis=1)
    return {"time_s": found.times.tolist(), "force_n": force.tolist()}


def rounded(value: Any) -> Any:
    """To seven digits."""
    if isinstance(value, dict):
        return {key: rounded(each) for key, each in value.items()}
    if isinstance(value, list):
        return [rounded(each) for each in value]
    return float(f"{value:.7g}") if isinstance(value, float) else value


if __name__ == "__main__":
    FILE.write_text(json.dumps(rounded(answers(Path(sys.argv[1])))), encoding="utf-8")
