"""c and m of one reading on the same limb in other poses: what another mesh changes, and the stated error.

    python -m tests.benchmarks.poses [--element tet4|tet10] [--poses NAME ...] [--size-mm 5] [--far-mm 8]

The reading (forces and speeds without noise) is that of a model of the limb as it lies; each pose of
`tests/meshing/test_pose.py` is meshed anew and fitted to it (`fit --objective joint`). As next to no noise is
stated, an interval is the mesh error that the result states; it should hold the value found as the limb lies.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from limbcli.case import Case
from limbcli.feb.settings import schedule
from limbcli.fitting.force_curves import LawCurve
from limbcli.fitting.laws import LAWS
from limbcli.meshing.remesh import Sizes
from limbcli.meshing.site_model import MeshOptions, site_model
from limbcli.model import Array, LimbModel
from limbcli.site_model.indentation_model import indentation_model
from limbcli.stages.fit import FitOptions
from limbcli.stages.fit_joint import fit_joint
from tests.meshing.test_pose import AXIS, PLACE, POSES, PROBE, posed
from tests.stages import block_case as block

C, SHAPE = 0.006, np.array([20.0, 4.0])  # MPa; f_kappa, m
DEPTHS = np.array([1.5, 3.0, 4.5])
_NOISE = {"force_n = 0.05": "force_n = 0.001", "depth_mm = 0.1": "depth_mm = 0.002"}


def model_of(pose: str | None, element: str, sizes: Sizes) -> LimbModel:
    """The site's mesh in a pose; None: as the limb lies."""
    turn, seed = (np.eye(3), None) if pose is None else POSES[pose]
    (x, y, z), axis = turn @ PLACE, turn @ AXIS
    options = MeshOptions(element=element, margin=20.0, sizes=sizes)
    return site_model(posed(turn, seed), (x, y, z), (axis[0], axis[1], axis[2]), PROBE, options).model


def reading_of(model: LimbModel) -> tuple[Array, Array]:
    """Forces (N) and speeds (m/s, from first touch on) of the true tissue."""
    ready = indentation_model(model, schedule(list(DEPTHS)), c=C, f_kappa=SHAPE[0], m=SHAPE[1])
    curve = LawCurve(ready, LAWS["ogden"], c=C, density_kg_per_m3=1000.0)
    try:
        forces, speeds = np.split(curve(SHAPE, (0, 1)).values, 2)
    finally:
        curve.close()
    return forces, speeds


def fitted(model: LimbModel, forces: Array, speeds: Array, folder: Path) -> Mapping[str, Any]:
    """What `fit --objective joint` writes of this reading on this model."""
    case = block.make_case(folder / "case", folder / "out", DEPTHS, forces, c=C, speeds=speeds, model=model)
    text = case.file.read_text().replace('source = "assumed"', "swe_level_fraction = 0.001")
    for old, new in _NOISE.items():
        text = text.replace(old, new)
    case.file.write_text(text)
    options = FitOptions(contact_check=False, boundary_check=False, max_interval_solves=8)
    return fit_joint(Case.open(case.folder), out=folder / "out", options=options).data


def change(found: Mapping[str, Any], plain: Mapping[str, Any], name: str) -> tuple[float, float, float]:
    """Change of a parameter, and the ends of its interval, as fractions of its plain value."""
    there = plain["parameters"][name]["value"]
    low, high = found["interval_95"][name]
    ends = (-np.inf if low is None else low / there - 1.0, np.inf if high is None else high / there - 1.0)
    return found["parameters"][name]["value"] / there - 1.0, *ends


def cells(found: Mapping[str, Any], plain: Mapping[str, Any]) -> list[str]:
    """Of c and m: the change, and the interval, which should hold 0, in percent."""
    several = [change(found, plain, name) for name in ("c_kpa", "m")]
    return [
        text
        for moved, low, high in several
        for text in (f"{100 * moved:+.1f}", f"{100 * low:+.1f} to {100 * high:+.1f}")
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--element", default="tet4", choices=("tet4", "tet10"))
    parser.add_argument("--poses", nargs="*", default=[*POSES])
    parser.add_argument("--size-mm", type=float, default=5.0)
    parser.add_argument("--far-mm", type=float, default=8.0)
    options = parser.parse_args()
    sizes = Sizes(under_probe=options.size_mm, far=options.far_mm)
    plain = model_of(None, options.element, sizes)
    forces, speeds = reading_of(plain)
    print("| element | pose | c, % | interval, % | m, % | interval, % |\n|-|-|-|-|-|-|", flush=True)
    with tempfile.TemporaryDirectory() as scratch:
        own = fitted(plain, forces, speeds, Path(scratch) / "plain")
        for k, pose in enumerate(options.poses):
            model = model_of(pose, options.element, sizes)
            found = fitted(model, forces, speeds, Path(scratch) / str(k))
            print(f"| {options.element} | {pose} | {' | '.join(cells(found, own))} |", flush=True)


if __name__ == "__main__":
    main()
