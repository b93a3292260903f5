"""A block of tissue in three states whose truth is known: simulated on one mesh, to be fitted on another."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from limbcli.case import Case
from limbcli.feb.settings import schedule
from limbcli.fitting.laws import LAWS
from limbcli.fitting.state_curve import StateCurve
from limbcli.inference.monotone_interpolation import pchip_inverse, pchip_sample
from limbcli.model.npz_file import save_model
from limbcli.results import open_stage
from limbcli.site_model.indentation_model import indentation_model
from limbcli.stages.build_feb import build_feb
from tests.stages import block_case as block

C, LAW = 0.006, "ogden"  # MPa
SHAPE = np.array([50.0, 6.0])  # f_kappa, m
WAY = "around"  # the image's lateral axis, as the probe lies across the limb
UNLOADED = 0.95  # the told stretch at which the truth is unloaded
TOLD = {"middle": 0.9, "bent": 0.72, "straight": 1.1}
DENSITY = 1000.0
FORCES = np.arange(0.0, 6.0)
FORCE_SD, DEPTH_SD, SPEED_SD = 0.05, 0.05, 0.03
FIT_MESH, OTHER_MESH = (8, 6, 3), (9, 7, 4)  # cells of the block that is fitted, and of one that is measured


def curve(ways: Sequence[str] = (WAY,), *, counts: tuple[int, int, int] = FIT_MESH):
    model = indentation_model(
        block.block_model(counts=counts), schedule([1.0, 2.0]), c=C, f_kappa=100.0, m=2.0
    )
    return StateCurve(model, LAWS[LAW], ways, [0.4, 1.0, 1.8, 2.8, 3.8], c=C, density_kg_per_m3=DENSITY)


def true_levels(made: StateCurve, stretches: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
    """Depth from first touch (mm) and speed (m/s) at `FORCES`."""
    theta, n = np.r_[SHAPE, stretches], len(made.depths)
    values, even = made(theta).values, np.exp(made.even_speed(theta)[0])
    depths, forces = np.r_[0.0, made.depths], np.r_[0.0, values[:n]]
    at = pchip_inverse(depths, forces, FORCES)
    speeds = np.r_[values[2 * n], values[n : 2 * n]] * even
    return at, np.exp(pchip_sample(depths, np.log(speeds), at).values)


def noisy(
    levels: Mapping[str, tuple[np.ndarray, np.ndarray]], seed: int | None
) -> dict[str, tuple[np.ndarray, ...]]:
    """force, depth, speed of each state, with noise (seed None: without)."""
    rng, found = np.random.default_rng(seed), {}
    scale = 0.0 if seed is None else 1.0
    for name, (depth, speed) in levels.items():
        loaded = FORCES > 0
        force = FORCES + scale * FORCE_SD * rng.standard_normal(len(FORCES)) * loaded
        read = depth + scale * DEPTH_SD * rng.standard_normal(len(FORCES)) * loaded
        found[name] = (
            force,
            np.maximum(read, 0.0),
            speed * np.exp(scale * SPEED_SD * rng.standard_normal(len(FORCES))),
        )
    return found


def case_text(given: Mapping[str, float | None], *, more: str = "") -> str:
    text = block.CASE_TOML.replace('levels = "levels.csv"\n', more)
    text = text.replace(
        'source = "assumed"', f'swe_level_fraction = {SPEED_SD}\nswe_pixel_fraction = 0.0\nsource = "spec"'
    )
    text = text.replace("depth_mm = 0.1", f"depth_mm = {DEPTH_SD}")
    for name, stretch in given.items():
        known = "" if stretch is None else f"stretch_{WAY} = {stretch}\n"
        text += f'[[site.state]]\nname = "{name}"\n{known}stretch_along = 1.0\nlevels = "{name}.csv"\n'
    return text


def make_case(folder: Path, out: Path, measured: Mapping[str, tuple[np.ndarray, ...]],
              given: Mapping[str, float | None] = TOLD, *, more: str = "") -> Case:  # fmt: skip
    """A case folder with these states; mesh and build-feb are done in `out`."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "case.toml").write_text(case_text(given, more=more))
    for name in ("skin.stl", "bone.stl"):
        (folder / name).write_text("solid empty\nendsolid empty\n")
    for name, (force, depth, speed) in measured.items():
        rows = [f"{f:.9g},{d:.9g},{v:.9g}" for f, d, v in zip(force, depth, speed, strict=True)]
        (folder / f"{name}.csv").write_text("\n".join(["force_n,depth_mm,swe_mean_m_per_s", *rows]) + "\n")
    case = Case.open(folder)
    with open_stage(out, "mesh", subject="B1", site="p1") as writer:
        save_model(block.block_model(), writer.file("model", "model.npz"))
    build_feb(case, out=out)
    return case
