"""segment: MRI series, label map or surfaces to skin, bones and markers.

Whatever the case brings, later stages find the same files: skin.ply, bone_*.ply.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from limbcli.case import Case
from limbcli.errors import CaseError
from limbcli.imaging.bones import name_bones
from limbcli.imaging.dicom import read_series
from limbcli.imaging.labels import read_labels, segmentation_from, write_labels
from limbcli.imaging.picture import contact_sheet
from limbcli.imaging.segmentation import Segmentation, segment_limb
from limbcli.imaging.surface import ClosedSurface, read_surface, surface_of, write_surface
from limbcli.imaging.volume import Volume
from limbcli.progress import SILENT, Progress
from limbcli.results import StageResult, StageWriter, open_stage

SKIN_EDGE, BONE_EDGE = 2.0, 1.5  # mm: edge lengths of the surfaces' triangles


def segment(case: Case, *, out: Path, progress: Progress = SILENT) -> StageResult:
    """Find skin, bones and markers; write label map, surfaces and contact sheet.

    The case's surfaces are taken if it names them, else its label map, else its MRI
    series is segmented.

    Raises
    ------
    CaseError
        If the input cannot be used; the message says why and what to do.
    """
    progress.event("stage", name="segment")
    with open_stage(out, "segment", subject=case.subject) as writer:
        if case.imaging.skin is not None:
            _from_surfaces(case, writer)
        elif case.imaging.labels is not None:
            _from_labels(case, case.imaging.labels, writer, progress)
        elif case.imaging.mri is not None:
            _from_series(case, case.imaging.mri, writer, progress)
        else:
            raise CaseError(
                "the case names no geometry",
                where=str(case.folder / "case.toml"),
                fix="set mri, labels, or skin and bones under [imaging]",
            )
    assert writer.result is not None
    return writer.result


def _from_series(case: Case, folder: Path, writer: StageWriter, progress: Progress) -> None:
    writer.used("mri", folder)
    series = read_series(folder, progress=progress)
    found = segment_limb(series.volume, progress=progress)
    writer.data["source"] = "mri"
    writer.data["image"] = dict(series.facts)
    writer.warnings.extend(series.notes)
    _write(case, series.volume, found, writer, progress)


def _from_labels(case: Case, path: Path, writer: StageWriter, progress: Progress) -> None:
    """A label map replaces the automatic segmentation; the series, if any, is only shown."""
    writer.used("labels", path)
    labels = read_labels(path)
    found = segmentation_from(labels)
    writer.data["source"] = "labels"
    writer.summary.append(f"label map {path.name} used instead of the automatic segmentation")
    _write(case, labels, found, writer, progress)


def _write(case: Case, image: Volume, found: Segmentation, writer: StageWriter, progress: Progress) -> None:
    if not found.bones:
        raise CaseError(
            "no bone was found",
            where=f"{case.subject}, segment",
            fix="give its place with --seed bone=x,y,z (patient LPS, mm), or [imaging] labels",
        )
    names = name_bones(found.bones)
    write_labels(writer.file("labels", "labels.nii.gz"), found.labels)
    surfaces = {"skin": surface_of(found.skin, edge=SKIN_EDGE)}
    progress.event("task", name="surfaces", done=1, total=1 + len(names))
    for number, (name, bone) in enumerate(zip(names, found.bones, strict=True), 2):
        surfaces[f"bone_{name}"] = surface_of(bone, edge=BONE_EDGE)
        progress.event("task", name="surfaces", done=number, total=1 + len(names))
    _write_surfaces(surfaces, writer)
    writer.data["markers"] = [
        {"number": each.number, "position_mm": each.position, "volume_mm3": each.volume}
        for each in found.markers
    ]
    if found.markers:
        writer.summary.append(f"{len(found.markers)} skin marker(s), numbered from distal to proximal")
    sheet = writer.file("contact_sheet", "contact-sheet.png")
    contact_sheet(sheet, image, found, title=f"{case.subject}: skin (yellow), bones ({', '.join(names)})")


def _from_surfaces(case: Case, writer: StageWriter) -> None:
    assert case.imaging.skin is not None
    writer.data["source"] = "surfaces"
    writer.data["markers"] = []
    surfaces = {}
    for name, path in [("skin", case.imaging.skin), *zip(_bone_names(case), case.imaging.bones, strict=True)]:
        writer.used(name, path)
        surfaces[name] = _usable(read_surface(path), name, path, writer)
    _write_surfaces(surfaces, writer)


def _bone_names(case: Case) -> list[str]:
    """bone_tibia where the file's name says so, else bone_1, bone_2 ..."""
    names = []
    for number, path in enumerate(case.imaging.bones, 1):
        known = [each for each in ("tibia", "fibula", "femur", "patella") if each in path.stem.lower()]
        name = f"bone_{known[0] if len(known) == 1 else number}"
        names.append(name if name not in names else f"bone_{number}")
    return names


def _usable(surface: ClosedSurface, name: str, path: Path, writer: StageWriter) -> ClosedSurface:
    """Normals outward; an open surface is passed on with a warning (meshing closes it)."""
    size = np.ptp(surface.points, axis=0).max()
    if not 5.0 < size < 2000.0:
        raise CaseError(
            f"the surface `{name}` is {size:.3g} mm across",
            where=str(path),
            fix="save it in mm (patient LPS frame)",
            size_mm=float(size),
        )
    if not surface.is_closed:
        writer.warnings.append(f"{path.name} is not closed; it will be closed when the model is cut")
    if surface.volume < 0:
        surface = ClosedSurface(surface.points, surface.triangles[:, ::-1].copy())
        writer.warnings.append(f"the normals of {path.name} pointed inward and were turned")
    return surface


def _write_surfaces(surfaces: dict[str, ClosedSurface], writer: StageWriter) -> None:
    volumes = {}
    for name, surface in surfaces.items():
        write_surface(writer.file(name, f"{name}.ply"), surface)
        volumes[name] = surface.volume / 1e3
        writer.summary.append(f"{name}: {volumes[name]:.1f} cm3, {len(surface.triangles)} triangles")
    writer.data["volume_cm3"] = volumes
