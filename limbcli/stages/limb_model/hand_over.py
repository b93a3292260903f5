"""The files of a limb's model for others: FEBio, ParaView, surfaces, parts, and a README."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from limbcli.config import templates_folder
from limbcli.feb.write import write_feb
from limbcli.files.plain_text import write_rows
from limbcli.files.template_rendering import plain_text_templates
from limbcli.meshing.export import write_vtu
from limbcli.meshing.limb_parts import LimbFrame, LimbParts
from limbcli.meshing.surfaces import Triangles, join
from limbcli.model import Array, LimbModel
from limbcli.model.abaqus_input import write_abaqus
from limbcli.model.npz_file import save_model
from limbcli.results import StageResult, StageWriter
from limbcli.site_model.indentation_model import TISSUE
from limbcli.stages.segmenting.surfaces import write_upright_aop
from limbcli.stiffness_field import LABELS
from limbcli.version import __version__

FEB, README = "limb.feb", "README.txt"


@dataclass(frozen=True, eq=False, kw_only=True)
class LimbFiles:
    """A limb's model, frame and side, its skin's facets, its parts, and the tissue's values by name
    (n_cells,)."""

    model: LimbModel
    frame: LimbFrame
    side: str
    skin: Triangles
    parts: LimbParts
    values: Mapping[str, Array]


def write_limb(files: LimbFiles, writer: StageWriter, segmented: StageResult, templates: Path | None) -> None:
    """Write all files of the model into the stage's folder; call it last, when all warnings are known."""
    model = files.model
    save_model(model, writer.file("model", "model.npz"))
    write_feb(model, writer.file("feb", FEB), templates)
    write_abaqus(model, writer.file("inp", "limb.inp"))
    write_vtu(model.mesh, writer.file("mesh", "limb.vtu"), values={TISSUE: files.values})
    write_stl(files.skin, writer.file("skin", "skin.stl"))
    bones = [
        Triangles(model.mesh.points, next(iter(model.mesh.surfaces[name].facets.values()))[:, :3]).flipped()
        for body in model.bodies
        for name in body.node_sets
    ]
    write_stl(join(bones), writer.file("bones", "bones.stl"))
    upright = files.frame.upright
    marks = {
        name.upper().replace("_", " "): upright(each[None])[0] for name, each in files.parts.landmarks.items()
    }
    wall = Triangles(upright(files.skin.points), files.skin.faces)
    write_upright_aop(
        wall, marks, files.side, writer, frame="the limb's own frame: left, back, up along its axis"
    )
    _write_parts(files, writer.file("parts", "parts.csv"))
    writer.file("readme", README).write_text(_readme(files, writer, segmented), encoding="utf-8")


def write_stl(surface: Triangles, path: Path) -> None:
    """Write a surface as binary STL, mm."""
    import meshio

    used = surface.part(np.arange(len(surface.faces)))
    meshio.Mesh(used.points, [("triangle", used.faces)]).write(path, file_format="stl", binary=True)


def _write_parts(files: LimbFiles, path: Path) -> None:
    """One row per patch (area, centroid) and landmark (its skin node)."""
    mesh, rows = files.model.mesh, []
    for name, mask in files.parts.patches.items():
        areas = files.skin.areas[mask]
        middle = np.average(files.skin.centroids[mask], axis=0, weights=areas)
        at = [f"{each:.3f}" for each in middle]
        rows.append(["patch", name, *at, f"{areas.sum():.1f}", int(mask.sum())])
    for name, nodes in mesh.node_sets.items():
        kind, _, short = name.partition("_")
        if kind in ("landmark", "site"):
            rows.append([kind, short, *(f"{each:.3f}" for each in mesh.points[nodes[0]]), "", ""])
    rows += [["missing", name, "", "", "", "", why] for name, why in files.parts.missing.items()]
    write_rows(path, ("kind", "name", "x_mm", "y_mm", "z_mm", "area_mm2", "facets"), rows)


def _readme(files: LimbFiles, writer: StageWriter, segmented: StageResult) -> str:
    """The README in plain text."""
    data: dict[str, Any] = writer.data
    stiffness, frame = data["stiffness"], data["frame"]
    layers = [
        f"{name}: {each['thickness_mm']:.1f} mm ({each['source']}), {each['law']}, c = {each['c_kpa']:g} kPa"
        + (f" ({', '.join(each['assumed'])} assumed)" if each["assumed"] else "")
        for name, each in data["layers"].items()
    ]
    of_sites = stiffness.get("field", {}).get("sites", {})
    sites = [
        f"site {name}: c = {each['c_kpa'][0]:.4g} kPa, from {each['source']}{_force_in_words(each)}"
        for name, each in of_sites.items() if "c_kpa" in each
    ]  # fmt: skip
    return (
        plain_text_templates(templates_folder() / "limb")
        .get_template("README.txt.j2")
        .render(
            subject=writer.subject,
            version=__version__,
            axis=_vector(frame["axis_lps"], 4),
            origin=_vector(frame["origin_lps"], 1),
            n_nodes=data["n_nodes"],
            n_cells=data["n_cells"],
            element=data["element"],
            size=f"{data['size_mm']:.1f}",
            surfaces=", ".join(name for name in data["surfaces"] if not name.startswith("patch_")),
            patches=", ".join(files.parts.patches) or "none",
            missing=files.parts.missing,
            m=f"{stiffness['m']:.4g}",
            f_kappa=f"{stiffness['f_kappa']:.4g}",
            c_kpa=f"{stiffness['c_kpa']:.4g}",
            c_source=stiffness["source"],
            labels=", ".join(f"{k} {name}" for k, name in enumerate(LABELS)),
            layers=layers,
            sites=sites,
            site_size=data["asked"].get("site_size"),
            source=segmented.data.get("source", "segment"),
            warnings=list(dict.fromkeys(writer.warnings)),
        )
    )


def _force_in_words(site: Mapping[str, Any]) -> str:
    """What the limb's force under a probe at a site is, of the one that its fit found."""
    if (simulated := site.get("force_on_limb")) is not None:
        return f"; under a probe the limb gives {100 * simulated:.1f} % of the fit's force (simulated)"
    if (taken := site.get("limb_over_site")) is None:
        return ""
    return f"; the limb is taken to give {100 * taken:.0f} % of the force of the site's model (not simulated)"


def _vector(values: list[float], digits: int) -> str:
    return "(" + ", ".join(f"{each:.{digits}f}" for each in values) + ")"
