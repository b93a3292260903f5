"""A tiny case whose truth is known: a block of tissue on a rigid base under the probe.

Its mesh is made by hand (no imaging, no meshing), its measurement by the reference
solver with known parameters, so that `fit` can be judged on it.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from limbcli.case import Case
from limbcli.feb.settings import schedule
from limbcli.materials.ogden import ogden_type
from limbcli.measurement.indentation import read_levels
from limbcli.meshing.probe import ProbeShape, probe_mesh
from limbcli.meshing.regions import facets, quadratic
from limbcli.model import Block, Curve, Domain, LimbModel, Mesh, Step, Support, Surface
from limbcli.model.bodies import Contact, Drive, RigidBody
from limbcli.model.npz_file import save_model
from limbcli.results import open_stage
from limbcli.site_model.indentation_model import indentation_model, with_penalty
from limbcli.solvers.session import ReferenceSession
from limbcli.stages.build_feb import TissueOptions, build_feb

PROBE = ProbeShape(20.0, 10.0, 3.0)
_HEX_TO_TETS = [[0, 1, 2, 6], [0, 2, 3, 6], [0, 3, 7, 6], [0, 7, 4, 6], [0, 4, 5, 6], [0, 5, 1, 6]]
CASE_TOML = """
format = 1
[subject]
id = "B1"
limb = "left"
[imaging]
skin = "skin.stl"
bones = ["bone.stl"]
[probe]
name = "block"
length_mm = 20.0
width_mm = 10.0
edge_radius_mm = 3.0
[[site]]
name = "p1"
position_mm = [0.0, 0.0, 0.0]
long_axis = "transverse"
levels = "levels.csv"
[site.noise]
force_n = 0.05
depth_mm = 0.1
source = "assumed"
"""


def block_model(element: str = "tet4", *, counts: tuple[int, int, int] = (8, 6, 3)) -> LimbModel:
    """Tissue 48 x 36 x 16 mm, finer under the probe, held at its base and sides."""
    nx, ny, nz = counts
    x = 24 * _graded(nx)
    y = 18 * _graded(ny)
    z = np.linspace(-16.0, 0.0, nz + 1)
    shape = (len(x), len(y), len(z))
    points = np.stack([axis.ravel() for axis in np.meshgrid(x, y, z, indexing="ij")], axis=1)
    number = np.arange(len(points)).reshape(shape)
    i, j, k = (each.ravel() for each in np.meshgrid(*(np.arange(n - 1) for n in shape), indexing="ij"))
    corners = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)]
    hexes = np.stack([number[i + a, j + b, k + c] for a, b, c in corners], axis=1)
    cells = np.concatenate([hexes[:, each] for each in _HEX_TO_TETS])
    top = hexes[k == nz - 1][:, 4:]
    skin = np.concatenate([top[:, [0, 1, 2]], top[:, [0, 2, 3]]])
    middle = None
    if element == "tet10":
        points, cells, middle = quadratic(points, cells)
    rigid = probe_mesh(PROBE)
    first = len(points)
    face = {"quad4": rigid.quads + first, "tri3": rigid.tips + first}
    held = (points[:, 2] < -15.999) | (np.abs(points[:, 0]) > 23.999) | (np.abs(points[:, 1]) > 17.999)
    mesh = Mesh(
        np.vstack([points, rigid.points - [0, 0, 0.05]]),
        (
            Block("tissue", element, cells),
            Block("probe", "quad4", face["quad4"]),
            Block("probe_tips", "tri3", face["tri3"]),
        ),
        {"fixed": np.flatnonzero(held)},
        {"contact": Surface("contact", facets(skin, middle)), "probe_face": Surface("probe_face", face)},
    )
    return LimbModel(
        mesh=mesh,
        materials={"tissue": ogden_type(c=0.005, f_kappa=100.0, m=2.0)},
        domains=(Domain("tissue", "tissue"),),
        bodies=(RigidBody("probe", (0.0, 0.0, -0.05), ("probe", "probe_tips")),),
        supports=(Support("fixed", ("x", "y", "z")),),
        drives=(
            *tuple(Drive("probe", dof, "fixed") for dof in ("x", "y", "u", "v", "w")),
            Drive("probe", "z", "displacement", -4.0, "load"),
        ),
        contacts=(Contact("contact", "probe_face"),),
        curves={"load": Curve(((0.0, 0.0), (1.0, 1.0)))},
        steps=(Step(),),
    )


def _graded(n: int) -> np.ndarray:
    """From -1 to 1, denser in the middle."""
    s = np.linspace(-1.0, 1.0, n + 1)
    return 0.6 * s + 0.4 * s**3


def true_curve(
    element: str, depths: np.ndarray, *, c: float, f_kappa: float, m: float, penalty: float = 20.0
) -> np.ndarray:
    """Forces (N) at depths (mm) of the block with these parameters."""
    model = indentation_model(block_model(element), schedule(list(depths)), c=c, f_kappa=f_kappa, m=m)
    model = with_penalty(model, penalty)
    session = ReferenceSession(model)
    try:
        return session.solve().must_points.forces
    finally:
        session.close()


def make_case(
    folder: Path, out: Path, depths: np.ndarray, forces: np.ndarray, *, c: float, element: str = "tet4",
    build: bool = True, speeds: np.ndarray | None = None, penalty: float | None = None,
    model: LimbModel | None = None,
) -> Case:  # fmt: skip
    """A case folder with this measurement; mesh (of `model` or a block) and build-feb are done in `out`."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "case.toml").write_text(CASE_TOML)
    for name in ("skin.stl", "bone.stl"):
        (folder / name).write_text("solid empty\nendsolid empty\n")
    speed = np.sqrt(c * 1e6 / 2 / 1000.0)
    rows = [f"0,0,{speed:.12g},0.1,100"]
    for k, (depth, force) in enumerate(zip(depths, forces, strict=True)):
        reading = ",," if speeds is None else f"{speeds[k]:.12g},0.1,100"
        rows.append(f"{force:.12g},{depth:.12g},{reading}")
    header = "force_n,depth_mm,swe_mean_m_per_s,swe_sd_m_per_s,swe_pixels"
    (folder / "levels.csv").write_text("\n".join([header, *rows]) + "\n")
    case = Case.open(folder)
    with open_stage(out, "mesh", subject="B1", site="p1") as writer:
        save_model(model or block_model(element), writer.file("model", "model.npz"))
    if build:
        build_feb(case, out=out, options=TissueOptions(contact_penalty=penalty))
    return case


__all__ = ["block_model", "make_case", "read_levels", "true_curve"]
