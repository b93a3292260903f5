"""segment: obtain skin, bones, fat and markers from an MRI or CT series, a label map or surfaces.

Whatever the case provides, later stages find the same files: skin.ply, bone_*.ply. A label map that
the user has edited by hand (OUT/segment/labels.nii.gz) takes precedence over all other inputs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from limbcli.case import Case
from limbcli.errors import CaseError
from limbcli.errors.problems import Problem, raise_errors
from limbcli.files.atomic import sha256
from limbcli.imaging.bones import name_bones
from limbcli.imaging.image_files import read_image
from limbcli.imaging.label_files import read_label_file
from limbcli.imaging.label_frame import frame_problems, in_order_of, same_grid
from limbcli.imaging.labels import segmentation_from, write_labels
from limbcli.imaging.layer_thickness import layers_at
from limbcli.imaging.limbs import Side
from limbcli.imaging.marker_skin import without_bumps
from limbcli.imaging.quality import assess
from limbcli.imaging.segmentation import Segmentation, SegmentationHints, segment_limb
from limbcli.imaging.segmentation_picture import contact_sheet
from limbcli.imaging.surface import BONE_EDGE, SKIN_EDGE, SMOOTH, surface_of
from limbcli.imaging.volume import Volume, unplaced
from limbcli.meshing.surfaces import Triangles
from limbcli.progress import SILENT, Progress
from limbcli.provenance.chain_inputs import noted
from limbcli.provenance.requested_options import requested_by_options
from limbcli.results import StageResult, StageWriter, data_if_there, open_stage, read_result
from limbcli.stages.segmenting.assumed import from_assumed
from limbcli.stages.segmenting.label_maps import labelled_limb
from limbcli.stages.segmenting.possible_sites import report_places
from limbcli.stages.segmenting.surfaces import check_limb, from_surfaces, write_skin_aop, write_surfaces

# Loss of a bone's volume by smoothing, as a fraction of that in the label map, above which a warning is
# given; smoothing of the usual width removes less.
_GONE = 0.15
LABELS = "labels.nii.gz"
EDITED = "edited labels"

Seed = tuple[str, tuple[float, float, float]]


@dataclass(frozen=True, kw_only=True)
class SegmentOptions:
    """Options of `segment`.

    seeds : ("bone", (x, y, z)) adds the bone whose marrow contains the point (patient LPS, mm);
        ("soft", (x, y, z)) states that a region taken for bone at the point is not bone
    smooth : standard deviation of the surfaces' smoothing, mm
    threshold : signal that separates air from skin, image units (HU on CT)
    limb : which of two limbs in the image; None: that stated by the case
    accept_bones : of bones outside the skin, keep what is inside, instead of refusing them
    aop : also write skin.aop, the skin as radii about an upright axis
    """

    seeds: tuple[Seed, ...] = ()
    smooth: float = SMOOTH
    threshold: float | None = None
    limb: Side | None = None
    accept_bones: bool = False
    aop: bool = False

    def hints(self, limb: Side) -> SegmentationHints:
        """Hints for the segmentation; limb : side stated by the case, used if no other was requested."""

        def points(kind: str) -> np.ndarray | None:
            found = [place for name, place in self.seeds if name == kind]
            return np.array(found) if found else None

        return SegmentationHints(self.threshold, points("bone"), points("soft"), self.limb or limb)


def segment(
    case: Case, *, out: Path, options: SegmentOptions = SegmentOptions(), fresh: bool = False,
    progress: Progress = SILENT,
) -> StageResult:  # fmt: skip
    """Find skin, bones, fat and markers; write label map, surfaces and contact sheet.

    In order of precedence the source is a label map edited by the user in the output folder, the
    case's surfaces, its label map, and its image series, which is segmented.

    fresh : ignore an edited label map and start again

    Raises as `limbcli.segment`.
    """
    progress.event("stage", name="segment")
    _check_seeds(options.seeds, case)
    edited = None if fresh else edited_labels(out)
    if edited is not None:
        _check_edited(case, out, edited)
    with open_stage(out, "segment", subject=case.subject) as writer:
        writer.data["asked"] = requested_by_options(options)
        case = noted(case, writer)
        if edited is not None:
            _from_edited(case, edited, options, writer, progress)
        elif case.imaging.assumed:
            from_assumed(case, writer, accept_bones=options.accept_bones)
        elif case.imaging.skin is not None:
            from_surfaces(case, writer, accept_bones=options.accept_bones)
        elif case.imaging.label_maps:
            _from_labels(case, options, writer, progress)
        elif case.imaging.mri is not None:
            _from_series(case, case.imaging.mri, options, writer, progress)
        else:
            raise CaseError(
                "the case specifies no geometry",
                where=str(case.folder / "case.toml"),
                fix="set mri, labels, or skin and bones under [imaging]",
            )
        if options.aop:
            write_skin_aop(case, writer)
    return writer.result


def _check_seeds(seeds: Sequence[Seed], case: Case) -> None:
    for name, place in seeds:
        if name not in ("bone", "soft") or not np.isfinite(place).all():
            raise CaseError(
                f"the seed {name} = {place} is not valid",
                where=f"{case.subject}, --seed",
                fix="write bone=x,y,z or soft=x,y,z with patient LPS mm",
            )


def edited_labels(out: Path) -> Path | None:
    """The label map in the output folder, if the user has changed it since it was written.

    One without a result that could show it is unchanged is also taken as edited.
    """
    path = out / "segment" / LABELS
    if not path.is_file():
        return None
    before = data_if_there(out, "segment")
    changed = sha256(path) != before.get("labels_sha256")
    return path if changed or before.get("source") == EDITED else None


def _check_edited(case: Case, out: Path, path: Path) -> None:
    """Check that a label map edited by hand is of this subject and of the series that the case now names."""
    aside = "copy it to where you want to keep it, then run `limbcli segment` with --fresh"
    try:
        before = read_result(out, "segment")
    except CaseError as error:
        raise CaseError(
            "there is a label map that may have been edited by hand, and no result next to it that shows "
            "whether it was",
            where=str(path),
            fix=f"{aside} (to use it, enter the copy as [imaging] labels)",
        ) from error
    drawn_on = before.provenance.get("made_from", {}).get("files", {}).get("imaging/mri")
    what = ""
    if before.subject != case.subject:
        what = f"the manually edited label map is of {before.subject}, but the case is of {case.subject}"
    elif drawn_on and case.imaging.mri is not None and sha256(case.imaging.mri) != drawn_on:
        what = "the label map was edited manually on another series than the one the case now refers to"
    if what:
        raise CaseError(what, where=str(path), fix=f"{aside}, or give another --out")


def _from_series(
    case: Case, path: Path, options: SegmentOptions, writer: StageWriter, progress: Progress
) -> None:
    series = read_image(path, progress=progress)
    modality = str(series.facts.get("modality", "MR"))
    hints = options.hints(case.limb)
    found = segment_limb(series.volume, modality=modality, hints=hints, progress=progress)
    writer.data["source"] = "mri"
    writer.data["image"] = dict(series.facts)
    writer.warnings.extend(f"{each.what}; {each.fix}" for each in unplaced(series.volume, path))
    writer.summary.extend(series.notes)  # what the reader repaired; it changes no result
    writer.warnings.extend(found.notes)
    _write(case, series.volume, found, options, writer, progress)


def _from_labels(case: Case, options: SegmentOptions, writer: StageWriter, progress: Progress) -> None:
    """Use label maps instead of the automatic segmentation."""
    writer.data["source"] = "labels"
    names = ", ".join(each.path.name for each in case.imaging.label_maps)
    writer.summary.append(f"label map {names} used instead of the automatic segmentation")
    _ignored(options, writer)
    limb = labelled_limb(case, side=options.limb or case.limb, progress=progress)
    writer.summary.extend(limb.lines)
    _place(limb.problems, limb.own_grid, writer)
    writer.warnings.extend(limb.found.notes)
    _write(case, limb.image, limb.found, options, writer, progress)


def _place(problems: Sequence[Problem], own_grid: bool, writer: StageWriter) -> None:
    """Raise or note what is wrong with a label map's position."""
    raise_errors(problems, CaseError)
    writer.warnings.extend(f"{each.what}; {each.fix}" for each in problems)
    if own_grid:
        writer.summary.append(
            "the label map has a different grid; it is positioned by its patient coordinates"
        )


def _image_of(case: Case, labels: Volume, path: Path, writer: StageWriter, progress: Progress) -> Volume:
    """The image series in the label map's axis order if both have the same grid; else the label map itself.

    Raises CaseError if label map and series do not cover the same region.
    """
    if case.imaging.mri is None:
        return labels
    series = read_image(case.imaging.mri, progress=progress).volume
    own_grid = not same_grid(labels, series)
    _place(frame_problems(labels, series, where=str(path)), own_grid, writer)
    return labels if own_grid else in_order_of(labels, series)


def _from_edited(
    case: Case, path: Path, options: SegmentOptions, writer: StageWriter, progress: Progress
) -> None:
    """Use the user's edit of an earlier label map."""
    writer.used("edited_labels", path)
    labels = read_label_file(path)
    writer.data["source"] = EDITED
    text = (
        f"the label map edited by hand in {path.parent} takes precedence over the automatic one (--fresh "
        f"starts anew)"
    )
    writer.summary.append(text)
    writer.warnings.append(text)
    _ignored(options, writer)
    image = _image_of(case, labels, path, writer, progress)
    found = segmentation_from(labels, side=options.limb or case.limb)
    writer.warnings.extend(found.notes)
    _write(case, image, found, options, writer, progress)


def _ignored(options: SegmentOptions, writer: StageWriter) -> None:
    if options.seeds or options.threshold is not None:
        writer.warnings.append("--seed and --threshold have no effect on a given label map")


def _write(
    case: Case,
    image: Volume,
    found: Segmentation,
    options: SegmentOptions,
    writer: StageWriter,
    progress: Progress,
) -> None:
    if not found.bones:
        raise CaseError(
            "no bone was found",
            where=f"{case.subject}, segment",
            fix="give a point in its marrow with --seed bone=x,y,z (patient LPS, mm), or [imaging] labels",
        )
    names = found.bone_names or name_bones(found.bones)
    labels = writer.file("labels", LABELS)
    write_labels(labels, found.labels)
    writer.data["labels_sha256"] = sha256(labels)
    skin, lowered = without_bumps(
        surface_of(found.skin, edge=SKIN_EDGE, smooth=options.smooth, where="skin"), found.markers
    )
    surfaces = {"skin": skin}
    progress.event("task", name="surfaces", done=1, total=1 + len(names))
    for number, (name, bone) in enumerate(zip(names, found.bones, strict=True), 2):
        key = f"bone_{name}"
        surfaces[key] = surface_of(bone, edge=BONE_EDGE, smooth=options.smooth, where=key)
        writer.warnings.extend(_thinned(key, bone, surfaces[key]))
        progress.event("task", name="surfaces", done=number, total=1 + len(names))
    where = f"{case.subject}, segment ({writer.data['source']})"
    surfaces = check_limb(surfaces, case, writer, where=where, accept_bones=options.accept_bones)
    write_surfaces(surfaces, writer)
    _report_markers(found, lowered, writer)
    report_places(case, surfaces, writer.data["markers"], writer)
    _report_layers(case, found, surfaces["skin"], writer)
    verdict = _report_quality(found, names, writer)
    sheet = writer.file("contact_sheet", "contact-sheet.png")
    contact_sheet(sheet, image, found, names, title=f"{case.subject}, distal to proximal; quality: {verdict}")


def _thinned(name: str, bone: Volume, surface: Triangles) -> list[str]:
    """A warning if smoothing removed a large part of a thin bone's volume."""
    gone = 1.0 - surface.volume / (float(bone.values.sum()) * bone.voxel_volume)
    if gone <= _GONE:
        return []
    return [f"smoothing took {gone:.0%} of {name}, which is thin: smooth less (--smooth)"]


def _report_markers(found: Segmentation, lowered: list[float], writer: StageWriter) -> None:
    writer.data["markers"] = [
        {"number": each.number, "position_mm": list(each.position), "volume_mm3": each.volume,
         "skin_lowered_mm": down}
        for each, down in zip(found.markers, lowered, strict=True)
    ]  # fmt: skip
    if found.markers:
        writer.summary.append(f"{len(found.markers)} skin marker(s), numbered from distal to proximal")


def _report_layers(case: Case, found: Segmentation, skin: Triangles, writer: StageWriter) -> None:
    """Report the thickness of skin and fat under each site whose position is known."""
    places = {each.number: each.position for each in found.markers}
    layers = {}
    for site in case.sites:
        position = site.position if site.marker is None else places.get(site.marker)
        if position is None or found.fat is None:
            continue
        found_layers = layers_at(np.array(position), skin, found.fat)
        if found_layers is None:
            writer.warnings.append(
                f"site {site.name}: no fat was found under the skin, its thickness is unknown"
            )
            continue
        layers[site.name] = {"skin_mm": found_layers.skin, "fat_mm": found_layers.fat}
        writer.summary.append(
            f"site {site.name}: fat {found_layers.fat:.1f} mm under {found_layers.skin:.1f} mm of skin"
        )
    writer.data["layers"] = layers


def _report_quality(found: Segmentation, names: tuple[str, ...], writer: StageWriter) -> str:
    quality = assess(found, names)
    writer.data["quality"] = {"verdict": quality.verdict, **quality.figures}
    writer.summary.append(f"quality: {quality.verdict}")
    for finding in quality.findings:
        writer.warnings.append(f"segmentation ({quality.verdict}): {finding}; check contact-sheet.png")
    return quality.verdict
