"""Output folder of a limb with other bones: its surfaces and the sites' own meshes."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Sequence
from pathlib import Path

from limbcli.case import Case, Site
from limbcli.errors import CaseError, LimbError
from limbcli.imaging.surface import ClosedSurface, write_surface
from limbcli.meshing.surfaces import read_surface
from limbcli.progress import Progress
from limbcli.results import StageResult, open_stage, plain, read_result, stage_folder
from limbcli.stages.diagnosis.bones.bone_hypotheses import OtherBones
from limbcli.stages.mesh import mesh_options, mesh_site, read_limb, site_position
from limbcli.stages.site_model.mesh_inputs import MeshInputs

_FORM = 2  # of what is written: increased where a limb that an earlier version wrote cannot be used


def limb_with(
    other: OtherBones, case: Case, sites: Sequence[Site], *, out: Path, work: Path, progress: Progress
) -> Path:
    """Make a folder laid out like an output folder, with `segment` and, for sites that are meshed, `mesh`.

    out : output folder of the case; work : parent of the new folder, in which an earlier one is reused

    Raises
    ------
    CaseError, MeshError
        If the site cannot be meshed with these bones.
    """
    segmented = read_result(out, "segment")
    folder = work / f".bones-{_key(other, segmented)}"
    if not (stage_folder(folder, "segment") / "segment.json").is_file():
        _write_segment(other, case, segmented, folder)
    for site in sites:
        _mesh(case, site, out=out, folder=folder, progress=progress)
    return folder


def _key(other: OtherBones, segmented: StageResult) -> str:
    known = segmented.provenance.get("files_sha256", {})
    surfaces = {name: known.get(name) for name in segmented.files}
    recipe = [_FORM, other.left_out, other.moved, surfaces, segmented.data]
    return hashlib.sha256(json.dumps(plain(recipe), sort_keys=True).encode()).hexdigest()[:12]


def _write_segment(other: OtherBones, case: Case, segmented: StageResult, folder: Path) -> None:
    with open_stage(folder, "segment", subject=case.subject) as writer:
        writer.data.update(segmented.data)
        writer.data["bones_changed"] = other.words
        writer.data["bones_moved"] = sorted(other.moved)
        for name, filename in segmented.files.items():
            path = segmented.path(name)
            if not name.startswith("bone_"):
                if path.suffix == ".ply":
                    shutil.copyfile(path, writer.file(name, filename))
                continue
            bone = other.of(name, read_surface(path))
            if bone is not None:
                write_surface(writer.file(name, filename), ClosedSurface(bone.points, bone.faces))


def _mesh(case: Case, site: Site, *, out: Path, folder: Path, progress: Progress) -> None:
    """Remake the site's own mesh with its options and the other bones, if the site has been meshed."""
    try:
        meshed = read_result(out, "mesh", site=site.name)
    except LimbError:
        return
    requested = meshed.data.get("asked", {})
    if meshed.data.get("layers") or "place" in requested:
        raise CaseError(
            "the site's mesh has layers, or a separate place", where=f"site {site.name}",
            fix="mesh the site without them to test its bones",
        )  # fmt: skip
    model = stage_folder(folder, "mesh", site.name) / "model.npz"
    segmented = read_result(folder, "segment")
    place = [site_position(site, segmented), site.long_axis, vars(case.probe), case.model.margin]
    made_of = plain({"asked": requested, "element": meshed.data.get("element"), "place": place})
    if model.is_file() and read_result(folder, "mesh", site=site.name).data.get("made_of") == made_of:
        return
    options = mesh_options(
        case, element=meshed.data.get("element"), size=requested.get("size"),
        far_size=requested.get("far_size"), margin=requested.get("margin"),
    )  # fmt: skip
    mesh_site(
        MeshInputs(case, segmented, requested), site, read_limb(segmented), options, {}, folder, progress,
        facts={"made_of": made_of},
    )  # fmt: skip
