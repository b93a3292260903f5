"""Pressures per patch against a limb whose stiffness is known and varies, by the field and by one c.

    python -m tests.benchmarks.socket_truth --work DIR [--seeds 2] [--field-alone]

The limb of cases/socket with a true c that varies smoothly (Gaussian random features of 60 mm, 15 to 60 % in
ln) and a true m, friction and place of the socket drawn as the intervals take them. Eight sites read c and m
with 10 % noise, averaged over the tissue below them. Per seed: mean pressure of every patch and load,
predicted from the field through the sites, its 95 % interval, and what one c for the whole limb (the sites'
geometric mean) predicts. Penalty contact alone in few load steps, the same for truth and prediction, so that
a seed takes a few minutes.
"""

from __future__ import annotations

import argparse
import shutil
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from scipy.spatial import cKDTree

from limbcli.case import Case
from limbcli.case.socket import socket_of
from limbcli.meshing.quality import volumes
from limbcli.meshing.surfaces import read_surface
from limbcli.model import Array, LimbModel
from limbcli.model.npz_file import load_model
from limbcli.progress import SILENT
from limbcli.sockets.alignment import misplaced
from limbcli.sockets.donning import DonningOptions, don_and_load
from limbcli.stages.in_socket.intervals import Pose, drawn_values, pressure_intervals
from limbcli.stages.in_socket.limb_in_socket import LimbInSocket, put_together
from limbcli.stages.in_socket.patch_table import WHOLE, PatchPressure, patch_masks, patch_rows
from limbcli.stages.limb import LimbOptions, limb
from limbcli.stages.limb_field.case_field import CaseField
from limbcli.stages.limb_model.element_values import field_values, with_element_values
from limbcli.stages.segment import segment
from limbcli.stiffness_field import Draws, limb_coordinates, stiffness_field
from limbcli.stiffness_field.draws import write_draws
from limbcli.stiffness_field.likelihood import Interval
from limbcli.stiffness_field.readings import SiteReading, region_below
from tests.benchmarks.seeded_rows import made as rows_made
from tests.benchmarks.seeded_rows import succeeded

CASE = Path(__file__).resolve().parents[2] / "cases" / "socket"
LOADS, NOISE, F_KAPPA, LENGTH = (100.0, 200.0), 0.1, 20.0, 60.0
FRICTION, FRICTION_DEVIATION, TILT_DEG, SHIFT_MM = 0.3, 0.1, 1.0, 1.0
EIGHT = [(0.25, 0), (0.25, 130), (0.25, 240), (0.45, 60), (0.45, 180), (0.65, 0), (0.65, 120), (0.65, 260)]
MOST = 1.959964


@dataclass(frozen=True, eq=False)
class Limb:
    """The meshed limb, and what its sites and field need."""

    case: Case
    model: LimbModel
    skin: object
    bones: list
    axis: Array
    origin: Array
    length: float

    @property
    def tissue(self):
        return self.model.mesh.block("tissue")

    @property
    def centroids(self) -> Array:
        return self.model.mesh.points[self.tissue.cells].mean(axis=1)

    def with_c(self, c: Array, m: float) -> LimbModel:
        return with_element_values(self.model, self.tissue, c, m=m, f_kappa=F_KAPPA)


def made(work: Path) -> Limb:
    folder, out = work / "case", work / "out"
    if not folder.is_dir():
        shutil.copytree(CASE, folder)
        segment(Case.open(folder), out=out)
        limb(Case.open(folder), out=out, options=LimbOptions(nodes=3000, c_kpa=16.0))
    case, model = Case.open(folder), load_model(out / "limb" / "model.npz")
    frame = model.info["frame"]
    bones = [read_surface(each) for each in sorted((out / "segment").glob("bone_*.ply"))]
    return Limb(
        case, model, read_surface(out / "segment" / "skin.ply"), bones, np.array(frame["axis_lps"]),
        np.array(frame["origin_lps"]), float(frame["length_mm"]),
    )  # fmt: skip


def regions(of: Limb) -> list[Array]:
    """The tissue below eight probes that lie along the limb: at heights (of its length) and angles (deg)."""
    tree = cKDTree(np.concatenate([each.points for each in of.bones]))
    axis, skin = of.axis / np.linalg.norm(of.axis), of.skin
    front = np.array([0.0, -1.0, 0.0]) - axis * -axis[1]
    front /= np.linalg.norm(front)
    side = np.cross(axis, front)
    from_axis = skin.centroids - of.origin
    height = from_axis @ axis
    found = []
    for share, degrees in EIGHT:
        near = np.flatnonzero(np.abs(height - share * of.length) < 6.0)
        middle = skin.centroids[near].mean(axis=0)
        away = np.cos(np.radians(degrees)) * front + np.sin(np.radians(degrees)) * side
        at = near[np.argmax((skin.centroids[near] - middle) @ away)]
        point, normal = skin.centroids[at], away
        deep = float(tree.query(point)[0])
        found.append(region_below(point, normal, axis, length=26.0, skin_bone=min(deep, 35.0)))
    return found


def smooth(points: list[Array], rng: np.random.Generator) -> list[Array]:
    """Values at lists of points of one smooth random function, with deviation 1."""
    waves, phase = rng.standard_normal((400, 3)) / LENGTH, rng.uniform(0, 2 * np.pi, 400)
    return [np.sqrt(2 / 400) * np.cos(each @ waves.T + phase).sum(axis=1) for each in points]


def interval(value: float) -> Interval:
    return Interval(value, float(value * np.exp(-MOST * NOISE)), float(value * np.exp(MOST * NOISE)))


def rows_of(together: LimbInSocket, model: LimbModel, friction: float, pose: Pose) -> list[PatchPressure]:
    options = DonningOptions(
        friction=friction, loads_n=LOADS, axis="z", donning_steps=6, load_steps=3, penalty=20.0,
        skin=together.touching,        search_radius_mm=max(30.0, together.fit.deepest_mm + 10.0),
    )  # fmt: skip
    states = don_and_load(model, misplaced(together.face, pose[:2], pose[2:]), options).states
    return patch_rows(states, patch_masks(together.limb), together.skin.areas)


@dataclass(frozen=True, eq=False)
class Truth:
    """A drawn limb: ln c of its elements, size of its variation, m, friction, pose; its sites' readings."""

    log_c: Array
    size: float
    m: float
    friction: float
    pose: Pose
    sites: list[SiteReading]


def drawn_truth(of: Limb, rng: np.random.Generator) -> Truth:
    centroids, at_sites = of.centroids, regions(of)
    mean = np.log(0.016) + 0.3 * rng.standard_normal()
    size = np.exp(rng.uniform(np.log(0.15), np.log(0.6)))
    truth, *below = (mean + size * each for each in smooth([centroids, *at_sites], rng))
    m = 3.0 * float(np.exp(0.1 * rng.standard_normal()))
    friction = max(FRICTION + FRICTION_DEVIATION * rng.standard_normal(), 0.01)
    pose = tuple((rng.standard_normal(4) * [TILT_DEG, TILT_DEG, SHIFT_MM, SHIFT_MM]).tolist())
    sites = [
        SiteReading(
            f"p{k}", where,
            {
                "c": interval(float(np.exp(values.mean() + NOISE * rng.standard_normal()))),
                "m": interval(m * float(np.exp(NOISE * rng.standard_normal()))),
                "f_kappa": interval(F_KAPPA),
            },
        )
        for k, (where, values) in enumerate(zip(at_sites, below, strict=True))
    ]  # fmt: skip
    return Truth(truth, float(size), m, friction, pose, sites)


def one(of: Limb, seed: int, work: Path) -> dict:
    given = socket_of(of.case)
    drawn_limb, centroids = drawn_truth(of, np.random.default_rng(seed)), of.centroids
    truth, m, friction, pose = drawn_limb.log_c, drawn_limb.m, drawn_limb.friction, drawn_limb.pose
    field = stiffness_field(limb_coordinates(of.skin, of.bones, of.axis), drawn_limb.sites)
    sizes = volumes(of.model.mesh.points, of.tissue.cells)
    values, law = field_values(CaseField(field, SimpleNamespace()), centroids, sizes)
    few = np.arange(0, len(centroids), 8)
    write_draws(work / "draws.csv", Draws(field).table(centroids[few], sizes[few]))
    drawn = drawn_values(
        work / "draws.csv", FRICTION, FRICTION_DEVIATION, tilt_deg=TILT_DEG, shift_mm=SHIFT_MM
    )
    place = SimpleNamespace(warnings=[])
    together = put_together(of.with_c(values.c, law.m), given, place)
    none: Pose = (0.0, 0.0, 0.0, 0.0)
    true_model = put_together(of.with_c(np.exp(truth), m), given, place).limb
    true = rows_of(together, true_model, friction, pose)
    base = rows_of(together, together.limb, FRICTION, none)
    found = pressure_intervals(
        together.limb, FRICTION, base, drawn, lambda model, mu, at: rows_of(together, model, mu, at), SILENT
    )
    c_mean = float(np.exp(np.mean([np.log(each.values["c"].value) for each in drawn_limb.sites])))
    flat = put_together(of.with_c(np.full(len(centroids), c_mean), law.m), given, place).limb
    one_c = rows_of(together, flat, FRICTION, none)
    pairs = []
    for real, field_row, flat_row in zip(true, base, one_c, strict=True):
        if real.patch == WHOLE or not real.contact_area_mm2:
            continue
        low, high = found.intervals[real.load_n, real.patch, "mean_kpa"]
        pairs.append({
            "load_n": real.load_n, "patch": real.patch, "true_kpa": real.mean_kpa,
            "field_kpa": field_row.mean_kpa, "low_kpa": low, "high_kpa": high, "one_c_kpa": flat_row.mean_kpa,
        })  # fmt: skip
    inside = (np.exp(truth) >= values.c_low) & (np.exp(truth) <= values.c_high)
    return {
        "c_deviation": drawn_limb.size, "held_out_error": found.error_fraction,
        "elements_inside": float(np.average(inside, weights=sizes)), "pairs": pairs,
    }  # fmt: skip


def field_alone(of: Limb, seeds: int) -> None:
    """Share of the tissue whose c is inside its interval, over many limbs; no solves."""
    coordinates = limb_coordinates(of.skin, of.bones, of.axis)
    sizes = volumes(of.model.mesh.points, of.tissue.cells)
    shares = []
    for seed in range(1, seeds + 1):
        drawn = drawn_truth(of, np.random.default_rng(seed))
        found, true = stiffness_field(coordinates, drawn.sites).at(of.centroids), np.exp(drawn.log_c)
        shares.append(float(np.average((true >= found.c_low) & (true <= found.c_high), weights=sizes)))
        print(f"| {seed} | {drawn.size:.2f} | {100 * shares[-1]:.1f} % |", flush=True)
    print(
        f"elements inside over {seeds} limbs: mean {100 * np.mean(shares):.1f} %, least "
        f"{100 * min(shares):.0f} %; in {sum(each >= 0.9 for each in shares)} of them 90 % or more"
    )


def line(found: dict) -> str:
    pairs = found["pairs"]
    inside = sum(each["low_kpa"] <= each["true_kpa"] <= each["high_kpa"] for each in pairs)
    off = {
        name: np.sqrt(
            np.mean([np.log(max(each[name], 0.1) / max(each["true_kpa"], 0.1)) ** 2 for each in pairs])
        )
        for name in ("field_kpa", "one_c_kpa")
    }
    return (
        f"| {found['seed']} | {found['c_deviation']:.2f} | {100 * found['elements_inside']:.0f} % "
        f"| {inside} of {len(pairs)} | {off['field_kpa']:.3f} | {off['one_c_kpa']:.3f} |"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--field-alone", action="store_true", help="only the field, without solves")
    options = parser.parse_args()
    options.work.mkdir(parents=True, exist_ok=True)
    of = made(options.work)
    if options.field_alone:
        field_alone(of, options.seeds)
        return
    print(
        "| seed | sd of ln c | elements inside | patches inside | field: rms of ln p | one c: rms of ln p |"
    )
    print("|-|-|-|-|-|-|")
    jobs = {(seed,): seed for seed in range(1, options.seeds + 1)}
    rows = rows_made(options.work / "seeds.jsonl", jobs, lambda seed: one(of, seed, options.work), show=None)
    print(*map(line, succeeded(rows)), sep="\n")


if __name__ == "__main__":
    main()
