"""What the diagnosis' models err by in maps of wave speed, and the sizes of that error that are likeliest.

    python -m tests.benchmarks.map_errors [--out FOLDER] [--only h05 h13] [--fit]

For every site of the FEBio study in the reference data (`febio-hidden`) with maps free of noise and without
its hidden effect: segmented and meshed into FOLDER, its working mesh tied to its own as `diagnose` does, and
ln speed of its parts at the true c, m and f_kappa (to first order) less FEBio's, at eight forces. A line a
site; with --fit the constants of `diagnosis.data.noise_parts` by maximum likelihood, beside those
that stand there, whose size is meant to be that of the worst site. What the limb's
far side rests on is allowed for as in a diagnosis.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import tomllib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize, minimize_scalar

from limbcli.case import Case
from limbcli.diagnosis.curves.curve_plan import FIRST_M
from limbcli.diagnosis.data import noise_parts
from limbcli.diagnosis.data.windows import Windows
from limbcli.diagnosis.forward_model.surrogate import AtPoints
from limbcli.diagnosis.mesh_error.mesh_correction import F_KAPPA
from limbcli.diagnosis.mesh_error.numerical_checks import (
    _FAR_SIDE_LEFT,
    INCOMPRESSIBILITY,
    STIFFER,
)
from limbcli.diagnosis.prepare import Prepared, WorkingMesh, prepare
from limbcli.effects import EFFECTS
from limbcli.effects.curves import Curves
from limbcli.effects.far_side import FAR_SIDE
from limbcli.model import Array, IntArray
from limbcli.progress import SILENT
from limbcli.stages.mesh import mesh
from limbcli.stages.segment import SegmentOptions, segment

SHARED = Path(os.environ.get("LIMBCLI_SHARED", Path(__file__).resolve().parents[3] / "shared"))
SITES = SHARED / "febio-hidden"
RECORDED = ["h02", "h03", "h05", "h06", "h07", "h08", "h09", "h11", "h13", "h15", "h19", "h20", "h23"]
NAMES = ("everywhere", "grows", "fades mm", "near mm", "alike", "at bone", "from bone mm")
_WITHIN, _TRIALS = 5.0, 600  # of the search for the likeliest sizes


@dataclass(frozen=True, eq=False)
class Off:
    """Ln speed of the model less FEBio's (n,), where and when.

    far_side (n,) : change by holding the limb's far side; from_bone (n,) : mm, from the nearest part in which
        there is nothing to compare
    """

    off: Array
    level: IntArray
    place: Array
    strain: Array
    far_side: Array
    from_bone: Array


def prepared_site(site: str, folder: Path) -> Prepared:
    """As `diagnose` prepares it; segmented and meshed into `folder` unless it is."""
    case, out = Case.open(SITES / site), folder / site
    if not (out / "mesh").is_dir():
        segment(case, out=out, options=SegmentOptions(accept_bones=True))
        mesh(case, out=out)
    effects = {each.name: each for each in EFFECTS if each.kind != "numerical"}
    return prepare(case, case.sites[0], effects, out=out, mesh=WorkingMesh(), progress=SILENT)


def record_of(site: str, windows: Windows) -> tuple[Array, Array, Array]:
    """FEBio's, without noise and without the hidden effect, where it has maps under load: depth (n,) mm,
    force (n,) N, ln speed (n, 1 + n_parts)."""
    from tests.benchmarks.what_maps_keep import at_forces

    exact = dict(np.load(SITES / "exact" / f"{site}.npz"))
    depth = exact["p1_without_map_depth_mm"][1:]
    force = np.interp(depth, exact["p1_without_depth_mm"], exact["p1_without_force_n"])
    maps = at_forces(exact, "without", force)
    return depth, force, np.array([windows.log_means(each)[0] for each in maps])


def measured(site: str, truth: dict, folder: Path) -> tuple[str, Off]:
    """A line to print, and the differences."""
    prepared = prepared_site(site, folder)
    try:
        prepared.curves.solve_nodes(FIRST_M)
        curves = prepared.curves.curves(truth["c_kpa"] / 1e3, truth["m"], AtPoints(), {})
        near = min(FIRST_M, key=lambda m: abs(np.log(m / truth["m"])))
        free, held, stiffer = (
            prepared.simulations.curves(near, changes)
            for changes in (
                (),
                ((FAR_SIDE, FAR_SIDE.start),),
                ((INCOMPRESSIBILITY, INCOMPRESSIBILITY.start),),
            )
        )
    finally:
        prepared.simulations.close()
    windows = prepared.simulations.windows
    depth, force, theirs = record_of(site, windows)
    ours = at_force(curves, curves.log_speed, force)
    per_c = force * prepared.simulations.c / (truth["c_kpa"] / 1e3)
    plain = at_force(free, free.log_speed, per_c)
    far = np.nan_to_num(at_force(held, held.log_speed, per_c) - plain)
    softer = (1.0 - F_KAPPA / truth["fk"]) / (1.0 - 1.0 / STIFFER)  # deviations of its prior
    off = ours + softer * (at_force(stiffer, stiffer.log_speed, per_c) - plain) - theirs[:, 1:]
    level, part = np.nonzero(np.isfinite(off))
    spread = " ".join(f"{100 * each:.1f}" for each in np.nanstd(off, axis=1))
    means = " ".join(f"{100 * each:.1f}" for each in np.nanmean(off, axis=1))
    by_fk = np.interp(depth, free.depth[1:], np.log(stiffer.force[1:] / free.force[1:]))
    ratio = np.interp(depth, curves.depth, curves.force) / force * np.exp(softer * by_fk)
    line = f"| {site} | {truth['m']:.1f} | {ratio[1]:.2f} to {ratio[-1]:.2f} | {means} | {spread} |"
    strain = depth[level] / truth["thickness_mm"]
    place = windows.middles[part]
    apart = np.linalg.norm(windows.middles[:, None] - windows.middles[None], axis=2)
    from_bone = np.where(np.isfinite(off)[:, None, :], np.inf, apart[None]).min(axis=2)
    return line, Off(off[level, part], level, place, strain, far[level, part], from_bone[level, part])


def at_force(curves: Curves, table: Array, force: Array) -> Array:
    """Columns of the parts (n, n_parts) of a table over the curves' depths, at these forces (n,)."""
    return np.array([np.interp(force, curves.force, column) for column in table[:, 1:].T]).T


def cost_of_site(sizes: Array, each: Off) -> tuple[float, float]:
    """Minus ln likelihood of a site, but for a constant, at its own size of the error; and that size."""
    everywhere, grows, fades, near, alike, at_bone, from_bone = sizes
    x, z = each.place.T
    deviation = (everywhere + np.exp(-(z - z.min()) / fades)) * each.strain**grows
    deviation *= 1.0 + at_bone * np.exp(-each.from_bone / from_bone)
    apart = np.hypot(np.subtract.outer(x, x), np.subtract.outer(z, z))
    kernel = np.exp(-apart / near) * alike ** np.abs(np.subtract.outer(each.level, each.level))
    kernel *= np.outer(deviation, deviation)
    besides = (
        _FAR_SIDE_LEFT**2 * np.outer(each.far_side, each.far_side) + np.eye(len(x)) * noise_parts._RESOLVED**2
    )

    def cost(ln_size: float) -> float:
        try:
            factor = cho_factor(np.exp(2 * ln_size) * kernel + besides, lower=True)
        except np.linalg.LinAlgError:  # errors that are all but one another's copies
            return np.inf
        return float(0.5 * each.off @ cho_solve(factor, each.off) + np.log(np.diag(factor[0])).sum())

    found = minimize_scalar(cost, bounds=np.log([0.02, 5.0]), method="bounded", options={"xatol": 0.05})
    return float(found.fun), float(np.exp(found.x))


def cost(sizes: Array, sites: list[Off]) -> float:
    """Minus ln likelihood of all sites, each with its own size of the error; sizes : by `NAMES`."""
    return sum(cost_of_site(sizes, each)[0] for each in sites)


def fitted(stands: Array, sites: list[Off]) -> tuple[float, Array]:
    """The largest ln likelihood within a factor of `_WITHIN` of what stands, and the sizes that give it."""
    alike = NAMES.index("alike")
    low, high = (np.log(each) for each in (stands / _WITHIN, stands * _WITHIN))
    low[alike], high[alike] = np.log([0.5, 0.999])
    best = minimize(
        lambda x: cost(np.exp(x), sites), np.log(stands), method="Powell",
        bounds=list(zip(low, high, strict=True)), options={"maxfev": _TRIALS, "xtol": 0.01, "ftol": 1e-5},
    )  # fmt: skip
    return -float(best.fun), np.exp(best.x)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path(tempfile.gettempdir()) / "map-errors")
    parser.add_argument("--only", nargs="*", default=RECORDED)
    parser.add_argument("--fit", action="store_true")
    options = parser.parse_args()
    truths = tomllib.loads((SITES / "truth.toml").read_text(encoding="utf-8"))["case"]
    print("| site | m | force over FEBio's | mean of ln speed, % | spread over the parts, % |\n|-|-|-|-|-|")
    found = []
    for truth in truths:
        if truth["id"] in options.only:
            line, off = measured(truth["id"], truth, options.out)
            found.append(off)
            print(line, flush=True)
    stands = np.array([
        noise_parts._EVERYWHERE, noise_parts._GROWS, noise_parts._FADES_MM, noise_parts._NEAR_MM,
        noise_parts._ALIKE, noise_parts._AT_BONE, noise_parts._FROM_BONE_MM,
    ])  # fmt: skip
    for name, each in zip(options.only, found, strict=False):
        print(f"{name}: size {cost_of_site(stands, each)[1]:.2f}, {noise_parts._BELOW_FACE:.2f} stands")
    print(f"ln likelihood of what stands: {-cost(stands, found):.0f}")
    if options.fit:
        most, likeliest = fitted(stands, found)
        print(f"likeliest: {most:.0f}")
        for name, one, other in zip(NAMES, stands, likeliest, strict=True):
            print(f"  {name:20s} {one:.3f} -> {other:.3f}")


if __name__ == "__main__":
    main()
