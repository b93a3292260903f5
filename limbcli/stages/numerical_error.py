"""How far a mesh alone may put the simulated force off: what intervals have to allow for."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from limbcli.case import Site
from limbcli.model import LimbModel
from limbcli.results import StageWriter, read_result, stage_folder

# What the mesh may add to the force, relative: of tet10 the change under refinement and with
# the penalty (2 to 3 % at 2.5 mm edges); of tet4 what locking leaves at f_kappa 1 (13 %).
GAIN_DEVIATION = {"tet10": 0.03, "tet4": 0.13}
_USUAL_SIZE, _NEAR_CENTRE = 2.5, 10.0


def gain_deviation(model: LimbModel, given: float | None) -> float:
    """Numerical error of the force, relative: stated, or a default by element and edge length."""
    if given is not None:
        return given
    return GAIN_DEVIATION.get(model.mesh.solid_blocks[0].kind, 0.05) * edge_under_probe(model) / _USUAL_SIZE


def edge_under_probe(model: LimbModel) -> float:
    """Median edge (mm) of the skin's facets within 10 mm of the probe's centre; 2.5 where there are none."""
    surface, points = model.mesh.surfaces.get("contact"), model.mesh.points
    if surface is None:
        return _USUAL_SIZE
    lengths = []
    for facets in surface.facets.values():
        corners = points[facets[:, :3]]
        near = np.hypot(*corners.mean(axis=1)[:, :2].T) < _NEAR_CENTRE
        lengths.append(np.linalg.norm(corners[near] - np.roll(corners[near], 1, axis=1), axis=2).ravel())
    edges = np.concatenate(lengths) if lengths else np.zeros(0)
    return float(np.median(edges)) if len(edges) else _USUAL_SIZE


def studied_error(site: Site, out: Path, writer: StageWriter, *, label: str = "") -> float | None:
    """What the mesh study of this site found, if there is one."""
    study = stage_folder(out, "mesh-study", site.name) / "mesh-study.json"
    if not study.is_file():
        return None
    writer.used(f"{label}mesh-study", study)
    found = read_result(out, "mesh-study", site=site.name).data.get("numerical_error_fraction")
    return float(found) if found is not None else None
