"""Hard solves, as a table: which end at the depth that is asked for, and what they cost.

    python -m tests.benchmarks.hard_solves [--mesh coarse|usual] [--sample 60] [--seed 0] [--out FILE]

The sites of the FEBio study in the reference data (`febio-hidden`) x m 2, 5, 10, 15 x f_kappa 100, 1000 x
contact penalty 20, 80 x depth 25, 40 % of the tissue under the probe, eight levels each; on top of the
middle of these, one at a time: tilt of 7 and 15 deg, friction 0.3, a skin 30 times as stiff, fat a quarter as
stiff, an inclusion five times as stiff, fibres, and the resident strain that 1.5 N leave. `coarse` is the
working mesh of a diagnosis, solved as there; `usual` that of `mesh`, solved as by `run`. A seeded sample;
one JSON line a solve is added to FILE (default: hard-solves-MESH.jsonl in the temporary folder), and what is
there is not done again. Meshes are kept beside it.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from limbcli.case import Case
from limbcli.diagnosis.prepare import size_for
from limbcli.effects import EFFECTS
from limbcli.errors import LimbError, SolveError
from limbcli.feb.settings import schedule
from limbcli.fem.analysis import Analysis, Snapshot
from limbcli.meshing.mending import mend
from limbcli.meshing.probe import ProbeShape
from limbcli.meshing.remesh import Sizes
from limbcli.meshing.site_model import MeshOptions, site_model
from limbcli.meshing.surfaces import read_surface
from limbcli.model import LimbModel, Material
from limbcli.model.npz_file import load_model, save_model
from limbcli.progress import SILENT
from limbcli.site_model.indentation_model import (
    TISSUE,
    fewer_steps,
    indentation_model,
    softer_jumps,
    starting_depth,
    with_penalty,
)
from limbcli.solvers.reference import prepare
from tests.benchmarks.seeded_rows import made, succeeded

SHARED = Path(os.environ.get("LIMBCLI_SHARED", Path(__file__).resolve().parents[3] / "shared"))
SITES = SHARED / "febio-hidden"
M, F_KAPPA, PENALTY, SHARE = (2.0, 5.0, 10.0, 15.0), (100.0, 1000.0), (20.0, 80.0), (0.25, 0.40)
MIDDLE = {"m": 5.0, "f_kappa": 100.0, "penalty": 20.0, "share": 0.25}
C, N_LEVELS, PATH_STEPS = 0.008, 8, 2
TOLERANCE = {"coarse": 1e-3, "usual": 1e-6}
LIMIT_S = {"coarse": 60.0, "usual": 180.0}
GOAL_S = {"coarse": (2.0, 10.0), "usual": (8.0, 30.0)}


def _effect(name: str, **theta: float) -> Callable[[LimbModel], LimbModel]:
    effect = next(each for each in EFFECTS if each.name == name)
    assert set(theta) <= set(effect.null), f"{name} has no {sorted(set(theta) - set(effect.null))}"
    return lambda model: effect.apply(model, {**effect.null, **effect.grid[0], **theta})


def _resident(model: LimbModel) -> LimbModel:
    """The strain along the beam that 1.5 N leave, by the mean pressure under the face, as a prestrain."""
    nodes = np.unique(
        np.concatenate([model.mesh.block(name).cells.ravel() for name in model.bodies[0].blocks])
    )
    side = np.ptp(model.mesh.points[nodes, :2], axis=0)
    stretch = float(np.exp(-1.5 / side.prod() / (1.5 * C)))
    F0 = (stretch**-0.5, 0.0, 0.0, 0.0, stretch**-0.5, 0.0, 0.0, 0.0, stretch)
    tissue = model.materials[TISSUE]
    return model.with_material(TISSUE, Material("prestrain", {"F0": F0, "ramp": 1.0}, parts=(tissue,)))


EXTRAS: dict[str, Callable[[LimbModel], LimbModel]] = {
    "tilt 7": _effect("tilt", tilt_about_short_axis_deg=7.0),
    "tilt 15": _effect("tilt", tilt_about_short_axis_deg=15.0),
    "friction 0.3": _effect("friction", friction_coefficient=0.3),
    "skin x 30": _effect("skin-layer", log_skin_ratio=np.log(30.0)),
    "fat / 4": _effect("adipose-layer", log_fat_softness=np.log(4.0)),
    "inclusion x 5": _effect("inclusion", log_inclusion_ratio=np.log(5.0)),
    "fibres": _effect("anisotropy", fibre_shear_per_c=1.0, fibre_tension_per_c=0.5),
    "prestrain": _resident,
}


@dataclass(frozen=True)
class Row:
    """One solve that is asked for."""

    site: str
    m: float
    f_kappa: float
    penalty: float
    share: float
    extra: str = ""

    @property
    def name(self) -> str:
        law = f"m {self.m:g} fk {self.f_kappa:g} pen {self.penalty:g}"
        return " ".join(filter(None, [self.site, law, f"{100 * self.share:g} %", self.extra]))


def rows(sites: list[str]) -> list[Row]:
    plain = [Row(*each) for each in itertools.product(sites, M, F_KAPPA, PENALTY, SHARE)]
    return plain + [Row(site, **MIDDLE, extra=extra) for site in sites for extra in EXTRAS]


def sample(every: list[Row], n: int, seed: int) -> list[Row]:
    """Three of four from the grid, one with something on top; all where there are no more."""
    if n >= len(every):
        return every
    rng = np.random.default_rng(seed)
    plain = [each for each in every if not each.extra]
    topped = [each for each in every if each.extra]
    n_topped = n // 4
    # every kind of extra about as often
    order = rng.permutation(len(topped))
    by_kind = [[topped[k] for k in order if topped[k].extra == kind] for kind in EXTRAS]
    turns = [each for each in itertools.chain(*itertools.zip_longest(*by_kind)) if each is not None]
    return [plain[k] for k in rng.permutation(len(plain))[: n - n_topped]] + turns[:n_topped]


def site_names() -> list[str]:
    """Sites with geometry of their own (h27 to h30 are measured anew)."""
    found = sorted(path.parent.name for path in SITES.glob("h*/case.toml"))
    return [name for name in found if name < "h27"]


def meshed(site: str, mesh: str, folder: Path) -> tuple[LimbModel, float]:
    """The site's model, and the thickness of tissue under the probe (mm); kept in the folder."""
    path, reported = folder / f"{site}-{mesh}.npz", folder / f"{site}-{mesh}.json"
    if not reported.is_file():
        case = Case.open(SITES / site)
        files = [
            SITES / site / "surfaces" / name
            for name in ("skin.stl", "femur.stl", "tibia.stl", "fibula.stl", "patella.stl")
        ]
        skin, *bones = (read_surface(each) for each in files if each.is_file())
        limb = mend(skin, bones)
        place = case.sites[0]
        probe = ProbeShape(case.probe.length, case.probe.width, case.probe.edge_radius)
        assert place.position is not None

        def make(sizes: Sizes) -> Any:
            return site_model(limb, place.position, place.long_axis, probe, MeshOptions(sizes=sizes))

        found = make(Sizes())
        thickness = float(found.checks.skin_bone_mm)
        if mesh == "coarse":
            found = make(Sizes(under_probe=size_for(thickness), far=14.0))
        save_model(found.model, path)
        reported.write_text(json.dumps({"thickness_mm": thickness}))
    return load_model(path), float(json.loads(reported.read_text())["thickness_mm"])


def built(row: Row, mesh: str, folder: Path) -> tuple[LimbModel, float]:
    model, thickness = meshed(row.site, mesh, folder)
    depth = row.share * thickness
    plan = schedule(
        [float(each) for each in np.linspace(0, depth, N_LEVELS + 1)[1:]],
        start=starting_depth(model, depth / N_LEVELS),
    )
    model = indentation_model(model, plan, c=C, f_kappa=row.f_kappa, m=row.m)
    model = replace(with_penalty(model, row.penalty), records=model.records[:1])
    if row.extra:
        model = softer_jumps(EXTRAS[row.extra](model))
    if model.has_friction:
        model = fewer_steps(model, PATH_STEPS * N_LEVELS)
    return model, depth


class TooLong(SolveError):
    """The limit of time of one solve."""


class Watch:
    """Stops a solve at its limit."""

    def __init__(self, limit_s: float):
        self.until = time.monotonic() + limit_s

    def __call__(self, kind: str, facts: dict[str, Any]) -> None:
        if kind == "newton" and time.monotonic() > self.until:
            raise TooLong("it takes too long", where="benchmark", fix="none")


def solve(
    row: Row, mesh: str, folder: Path, *, tolerance: float, threads: int, limit_s: float
) -> dict[str, Any]:
    model, depth = built(row, mesh, folder)
    reached: list[tuple[float, float]] = []

    def visit(_: Analysis, found: Snapshot) -> None:
        reached.append((float(-found.forces.bodies[0, 2]), found.forces.worst))

    reported: dict[str, Any] = {"name": row.name, "extra": row.extra, "depth_mm": round(depth, 2)}
    start, cpu = time.perf_counter(), time.process_time()
    analysis = prepare(model, SILENT.also(Watch(limit_s)), threads=threads, tolerance=tolerance)
    try:
        analysis.run(visit)
        reported["ended"] = True
    except LimbError as error:
        reported |= {"ended": False, "why": error.what, "where": error.where}
    counts = analysis.totals()
    reported |= {
        "levels": len(reached), "reached_mm": round(depth * len(reached) / max(len(_levels(model)), 1), 2),
        "equations": analysis.system.n_unknowns, "factorisations": counts.factorisations,
        "krylov": counts.krylov, "iterations": counts.iterations, "residuals": counts.residuals,
        "cuts": counts.retries, "seconds": round(time.perf_counter() - start, 2),
        "cpu": round(time.process_time() - cpu, 2), "force_n": round(reached[-1][0], 4) if reached else None,
        "worst": round(reached[-1][1], 3) if reached else None,
    }  # fmt: skip
    analysis.close()
    return reported


def _levels(model: LimbModel) -> list[float]:
    from limbcli.fem.equilibrium.solve_times import step_times

    step = model.steps[0]
    return step_times(step, every=model.has_friction)


def table(found: list[dict[str, Any]]) -> str:
    heads = (
        "name", "ended", "reached_mm", "depth_mm", "levels", "factorisations", "krylov", "iterations", "cuts",
        "seconds", "cpu", "force_n",
    )  # fmt: skip
    body = ["| " + " | ".join(str(each.get(h, "")) for h in heads) + " |" for each in found]
    return "\n".join(["| " + " | ".join(heads) + " |", "|" + "-|" * len(heads), *body])


def summary(found: list[dict[str, Any]], mesh: str) -> Iterator[str]:
    kinds = ["", *sorted({each["extra"] for each in found if each["extra"]})]
    median, worst = GOAL_S[mesh]
    yield f"| {mesh} | ended | median s | worst s | median cpu | factorisations | Krylov iterations |"
    yield "|-|-|-|-|-|-|-|"
    for kind in ["all", *kinds]:
        mine = [each for each in found if kind in ("all", each["extra"])]
        if not mine:
            continue
        ends = sum(each["ended"] for each in mine)
        seconds = [each["seconds"] for each in mine]
        figures = [np.median([each[key] for each in mine]) for key in ("cpu", "factorisations", "krylov")]
        yield (
            f"| {kind or 'plain'} | {ends} of {len(mine)} | {np.median(seconds):.1f} | {max(seconds):.1f} | "
            f"{figures[0]:.1f} | {figures[1]:.0f} | {figures[2]:.0f} |"
        )
    yield f"asked: 99 % end, median {median:g} s, worst {worst:g} s"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--mesh", choices=sorted(TOLERANCE), default="coarse")
    parser.add_argument("--sample", type=int, default=60)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--tolerance", type=float)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--work", type=Path, default=Path(tempfile.gettempdir()) / "hard-solves")
    parser.add_argument("--only", default="", help="rows whose name has this in it")
    parser.add_argument("--limit-s", type=float)
    options = parser.parse_args()
    if not SITES.is_dir():
        parser.error(f"the reference data are not at {SITES}; name their folder with LIMBCLI_SHARED")
    options.work.mkdir(parents=True, exist_ok=True)
    out = options.out or Path(tempfile.gettempdir()) / f"hard-solves-{options.mesh}.jsonl"
    requested = sample(rows(site_names()), options.sample, options.seed)
    jobs = {(each.name,): each for each in requested if options.only in each.name}
    one = partial(
        solve, mesh=options.mesh, folder=options.work, threads=options.threads,
        tolerance=options.tolerance or TOLERANCE[options.mesh],
        limit_s=options.limit_s or LIMIT_S[options.mesh],
    )  # fmt: skip
    found = [row for row in succeeded(made(out, jobs, one, key=("name",))) if (row["name"],) in jobs]
    print(table(found))
    print("\n".join(summary(found, options.mesh)))


if __name__ == "__main__":
    main()
