"""The published parameter sets in linear and in quadratic tetrahedra, on the case's shape or on others.

    python tests/benchmarks/paper_parameters.py                     a table for cases/paper-parameters
    python tests/benchmarks/paper_parameters.py --openlimb          ... and for OpenLimb's mean limb
    python tests/benchmarks/paper_parameters.py --write             write the case's levels.csv anew

The measurements of cases/paper-parameters are what its mesh answers in tet4 with the published
parameters; after a change of the mesher `--write` makes them again.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from limbcli.case import Case
from limbcli.errors import SolveError
from limbcli.feb.settings import schedule
from limbcli.inference.monotone_interpolation import pchip_sample
from limbcli.meshing.elements import with_element
from limbcli.model import Array, LimbModel
from limbcli.model.npz_file import load_model
from limbcli.site_model.indentation_model import indentation_model, starting_depth
from limbcli.solvers.session import ReferenceSession
from limbcli.stages.mesh import MeshRequest, mesh
from limbcli.stages.segment import segment

CASE = Path(__file__).resolve().parents[2] / "cases" / "paper-parameters"
FORCES = np.array([4.0, 8.0, 16.0, 24.0])  # N, of tet4


@dataclass(frozen=True)
class Published:
    """speed at 0 N (m/s), and the Ogden type's f_kappa and m; c = 2 rho v^2."""

    speed_m_per_s: float
    f_kappa: float
    m: float

    @property
    def c(self) -> float:
        return 2e-3 * self.speed_m_per_s**2


# c = 5.445, 10.488, 7.841 kPa are these speeds to all digits.
PUBLISHED = {
    "S1": Published(1.65, 113.0, 1.39),
    "S2-left": Published(2.29, 658.0, 1.04),
    "S2-right": Published(1.98, 146.0, 3.2),
}


def forces_at(model: LimbModel, depths: Array, tissue: Published, *, tolerance: float = 1e-6) -> Array:
    """N (n_depths,)."""
    plan = schedule(list(depths), start=starting_depth(model, float(depths[0])))
    ready = indentation_model(model, plan, c=tissue.c, f_kappa=tissue.f_kappa, m=tissue.m)
    session = ReferenceSession(ready, tolerance=tolerance)
    try:
        return session.solve().must_points.forces
    finally:
        session.close()


def depths_for(model: LimbModel, tissue: Published) -> Array:
    """Depths (mm, to 0.01) at which tet4 answers with FORCES."""
    depths = forces = np.zeros(1)
    for deepest in (3.0, 6.0, 12.0, 18.0):
        depths = deepest * np.arange(1, 9) / 8
        forces = forces_at(model, depths, tissue, tolerance=1e-4)
        if forces[-1] > FORCES[-1]:
            break
    return np.round(pchip_sample(np.r_[0.0, forces], np.r_[0.0, depths], FORCES).values, 2)


def models(case: Case, out: Path) -> Iterator[tuple[str, LimbModel]]:
    segment(case, out=out)
    for result in mesh(case, out=out, options=MeshRequest(element="tet4")):
        yield str(result.site), load_model(result.path("model"))


def write_levels(case: Case) -> None:
    with tempfile.TemporaryDirectory() as folder:
        for name, model in models(case, Path(folder)):
            tissue = PUBLISHED[name]
            depths = depths_for(model, tissue)
            forces = forces_at(model, depths, tissue)
            rows = [
                f"0,0,{tissue.speed_m_per_s:g}",
                *(f"{f:.4f},{d:.2f}," for f, d in zip(forces, depths, strict=True)),
            ]
            path = case.site(name).levels
            path.write_text("\n".join(["force_n,depth_mm,swe_mean_m_per_s", *rows]) + "\n")
            print(path, rows)


def compare(label: str, model: LimbModel) -> None:
    """One line a parameter set: the force of tet4 and of tet10 at the depth where tet4 answers with 24 N."""
    for name, tissue in PUBLISHED.items():
        depths = depths_for(model, tissue)
        linear = forces_at(model, depths, tissue, tolerance=1e-4)[-1]
        try:
            quadratic = forces_at(with_element(model, "tet10"), depths, tissue, tolerance=1e-4)[-1]
        except SolveError as error:
            print(f"{label:18} {name:9} tet10 failed: {error.what}")
            continue
        tissue_words = f"c {1e3 * tissue.c:6.3f} kPa  f_kappa {tissue.f_kappa:5.0f}  m {tissue.m:4.2f}"
        forces = f"tet4 {linear:6.2f} N, tet10 {quadratic:6.2f} N, ratio {linear / quadratic:5.2f}"
        print(f"{label:18} {name:9} {tissue_words}  {depths[-1]:5.2f} mm: {forces}", flush=True)


def openlimb() -> tuple[str, LimbModel] | None:
    """OpenLimb's mean limb at a posterior place, or None where the data are not at hand."""
    from limbcli.meshing.frame import skin_point_at
    from limbcli.meshing.site_model import MeshOptions, site_model
    from tests.benchmarks.mesh_sites import PROBE, SHARED, limbs

    if not (SHARED / "openlimb").is_dir():
        print(f"no OpenLimb shapes at {SHARED}")
        return None
    name, limb, heights = next(each for each in limbs() if "Mean" in each[0])
    x, y, z = (float(each) for each in skin_point_at(limb, 180.0, heights[1]))
    made = site_model(limb, (x, y, z), "transverse", PROBE, MeshOptions(element="tet4"), name="posterior")
    return name, made.model


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--write", action="store_true")
    parser.add_argument("--openlimb", action="store_true")
    requested = parser.parse_args()
    case = Case.open(CASE)
    if requested.write:
        write_levels(case)
        return
    with tempfile.TemporaryDirectory() as folder:
        compare("shape of the case", next(models(case, Path(folder)))[1])
    found = openlimb() if requested.openlimb else None
    if found is not None:
        compare(*found)


if __name__ == "__main__":
    main()
