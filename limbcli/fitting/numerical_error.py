"""Discretisation error of the simulated force, which the intervals include."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from limbcli.case import Case, Site
from limbcli.errors import CaseError
from limbcli.model import LimbModel
from limbcli.provenance.staleness import Chain
from limbcli.results import StageWriter, data_if_there, stage_folder

# Relative error of the force due to the mesh: for tet10 the change with refinement and with the
# penalty (2 to 3 % at 2.5 mm edges), for tet4 that due to locking at f_kappa 1 (13 %).
GAIN_DEVIATION = {"tet10": 0.03, "tet4": 0.13}
_USUAL_SIZE, _NEAR_CENTRE = 2.5, 10.0
# Ratio of the tet4 force to the tet10 force, by f_kappa: a punch of the probe's size on a 25 mm layer, edges
# 2.5 to 3 mm. Limbs give similar ratios (2.2 to 2.6 at 98, 6.1 to 7.4 at 641); halving the edge length
# reduces them little. Coarser meshes lock more, the ratio's logarithm about in proportion to the edge length:
# at 4.6 mm the ratio is 2.2 at f_kappa 20 and 4.7 at 100.
_LOCKED_SIZE = 3.0
_LOCKED_F_KAPPA = (1.0, 10.0, 50.0, 100.0, 200.0, 650.0, 1000.0)
_LOCKED_FORCE = (1.13, 1.31, 1.90, 2.47, 3.39, 6.29, 8.0)


def gain_deviation(
    model: LimbModel, given: float | None, *, studied: float | None = None, f_kappa: float | None = None
) -> float:
    """Numerical error of ln force, one standard deviation: given, or studied (at the start values), or by
    element type and edge length.

    f_kappa : the locking error of linear tetrahedra there, taken as two standard deviations, is a lower
        limit, as the mesh is studied at another f_kappa
    """
    if given is not None:
        return given
    kind = model.mesh.solid_blocks[0].kind
    edge = edge_under_probe(model)
    usual = GAIN_DEVIATION.get(kind, 0.05) * edge / _USUAL_SIZE
    found = usual if studied is None else studied
    if kind != "tet4" or f_kappa is None:
        return found
    locked = np.interp(np.log(f_kappa), np.log(_LOCKED_F_KAPPA), np.log(_LOCKED_FORCE))
    return max(found, 0.5 * float(locked) * max(1.0, edge / _LOCKED_SIZE))


def edge_under_probe(model: LimbModel) -> float:
    """Median edge length (mm) of the skin's facets within 10 mm of the probe's centre; 2.5 if none."""
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


def studied_error(case: Case, site: Site, out: Path, writer: StageWriter, *, label: str = "") -> float | None:
    """Relative error of the force by the site's mesh study; None unless the study is of the current mesh."""
    study = stage_folder(out, "mesh-study", site.name) / "mesh-study.json"
    if not study.is_file():
        return None
    writer.used(f"{label}mesh-study", study)
    try:
        result = Chain(case, out).result("mesh-study", site=site.name)
    except CaseError as error:
        writer.warnings.append(
            f"the mesh study of site {site.name} is not used: {error.what}; run {error.fix}"
        )
        return None
    studied = result.data
    # how the mesh that was studied differs from the current one
    meshed = data_if_there(out, "mesh", site=site.name)
    keys = ("element", "size_under_probe_mm", "margin_mm")
    unlike = [key for key in keys if key in studied and key in meshed and studied[key] != meshed[key]]
    if unlike:
        other = ", ".join(f"{key} {studied[key]} instead of {meshed[key]}" for key in unlike)
        writer.warnings.append(
            f"the mesh study of site {site.name} is of another mesh ({other}) and is not used: run "
            "`limbcli mesh --study` again"
        )
        return None
    writer.used_result(result, data=["numerical_error_fraction"])
    found = studied.get("numerical_error_fraction")
    return float(found) if found is not None else None
