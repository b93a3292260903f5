"""Surfaces instead of an image: closed or open, one body per file or all in one; and the output files."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from limbcli.case import Case, Imaging
from limbcli.errors import CaseError, MeshError
from limbcli.errors.problems import Problem, raise_errors
from limbcli.imaging.surface import read_surface, write_surface
from limbcli.meshing.anatomy import IN_ONE_FRAME, LEAST_BONE, SKIN, bones_outside, limb_problems
from limbcli.meshing.domain import part_inside
from limbcli.meshing.facets import divided
from limbcli.meshing.mending import (
    enclosed,
    largest_and_fragments,
    lies_within,
    open_rims,
    skin_and_bones,
    turned_inward,
    without_cavities,
)
from limbcli.meshing.sites_on_skin import triple
from limbcli.meshing.surfaces import Triangles, join
from limbcli.model import Array
from limbcli.results import StageWriter
from limbcli.stages.segmenting.bone_names import names_of_bodies, names_of_files, numbered
from limbcli.stages.segmenting.possible_sites import report_places
from limbcli.surface_formats.aop import aop_limb, read_aop_limb, write_aop
from limbcli.surface_formats.colours import has_colours
from limbcli.surface_formats.stated_frame import mixed_frames, stated_frame

# Later steps use points and triangles. Triangles of drawn (CAD) bodies can span the whole limb and are
# divided; those of a scan do so only at its flat ends, and are kept as given.
AOP_FILE = "skin.aop"
_AS_STATED = Imaging()  # of which case.toml says neither unit nor side
_LONGEST_EDGE = 25.0  # mm, longest edge of a divided body
# a bone is held by the skin's file too if more than this share of its triangles is there, so close, mm
_HELD, _SAME_MM = 0.9, 0.01
_NAMED = 3  # pieces of a skin's file that a warning names
_DRAWN_SHARE = 0.5  # share of area in triangles with a longer edge above which a body is taken as drawn


def from_surfaces(case: Case, writer: StageWriter, *, accept_bones: bool = False) -> None:
    """Check the case's own surfaces and write them under the usual names."""
    assert case.imaging.skin is not None
    writer.data["source"] = "surfaces"
    writer.data["markers"] = []
    surfaces, paths, left_out = read_surfaces(case)
    writer.warnings.extend(left_out)
    converted, mixed = frames_of(case)
    writer.summary.extend(converted)
    writer.warnings.extend(each.what for each in mixed)
    if not case.imaging.bones:
        writer.summary.append(
            f"{case.imaging.skin.name} contains {len(surfaces)} bodies: the largest is the skin, "
            "the others bones"
        )
    surfaces = {
        name: _usable(each, name, paths.get(name, case.imaging.skin), writer)
        for name, each in surfaces.items()
    }
    surfaces = check_limb(surfaces, case, writer, where=str(case.imaging.skin), accept_bones=accept_bones)
    write_surfaces(surfaces, writer)
    report_places(case, surfaces, [], writer)


def check_limb(
    surfaces: Mapping[str, Triangles], case: Case, writer: StageWriter, *, where: str,
    accept_bones: bool = False,
) -> dict[str, Triangles]:  # fmt: skip
    """Check whether skin and bones can be a limb's, and return them; unusual findings are warnings.

    accept_bones : of bones outside the skin, return what is inside, with a warning

    Raises CaseError listing everything impossible: a bone outside the skin, sizes in another unit.
    """
    kept = _inside_skin(surfaces, writer, where) if accept_bones else dict(surfaces)
    problems = limb_problems(kept, limb=case.limb, where=where)
    raise_errors(problems, CaseError)
    writer.warnings.extend(f"{each.what}; {each.fix}" for each in problems)
    return kept


def _inside_skin(surfaces: Mapping[str, Triangles], writer: StageWriter, where: str) -> dict[str, Triangles]:
    """Skin and bones, without what the bones that would be refused have outside the skin."""
    kept = dict(surfaces)
    skin, outside = bones_outside(surfaces, where=where)
    for name, what in outside.items():
        part = part_inside(surfaces[name], skin)
        if part is None:
            del kept[name]
        else:
            kept[name] = part
        done = "it is left out" if part is None else "only the part inside is kept"
        writer.warnings.append(
            f"{what}: {done} (--accept-bones), and the model is too soft where it is missing"
        )
    if len(kept) == 1:
        raise CaseError("no bone lies inside the skin", where=where, fix=IN_ONE_FRAME)
    return kept


def frames_of(case: Case) -> tuple[list[str], list[Problem]]:
    """Lines on the case's surfaces: conversions to patient LPS and mm, landmarks, colours that are ignored;
    and a warning if not all were converted. Raises CaseError if one states the other side than the case.
    """
    paths = [path for path in (case.imaging.skin, *case.imaging.bones) if path is not None]
    stated = [stated_frame(path) for path in paths]
    mixed = mixed_frames(stated)
    found = [Problem(mixed, str(paths[0]), IN_ONE_FRAME, severity="warning")] if mixed else []
    lines = [*(each.converted for each in stated if each.converted), *_by_case(case.imaging)]
    coloured = [path.name for path in paths if has_colours(path)]
    if coloured:
        lines.append(
            f"the colours of {', '.join(coloured)} are ignored: state where a coloured landmark lies by "
            "position_mm of its [[site]]"
        )
    return lines + [line for path in paths for line in _of_aop(path, case)], found


def _of_aop(path: Path, case: Case) -> list[str]:
    """The landmarks of an AOP file, as a line. Raises CaseError if it states the other side than the case."""
    if path.suffix.lower() != ".aop":
        return []
    try:
        limb = read_aop_limb(path)
    except OSError:
        return []  # reported where its surface is read
    shown = ("right" if case.limb == "left" else "left") if case.imaging.mirrored else case.limb
    if limb.side and limb.side != shown:
        raise CaseError(
            f"{path.name} states that it is the {limb.side} limb, but case.toml says {shown}",
            where=str(path),
            fix='correct limb = "left" or "right" under [subject], or give the file of this limb',
        )
    side = (-1.0, 1.0, 1.0) if case.imaging.mirrored else (1.0, 1.0, 1.0)
    places = [f"{name} {triple(each * side)}" for name, rows in limb.landmark_points.items() for each in rows]
    return [f"landmarks of {path.name}, as for position_mm: {', '.join(places)}"] if places else []


def read_surfaces(case: Case) -> tuple[dict[str, Triangles], dict[str, Path], list[str]]:
    """Skin and bones by name as given, the files named by the case, and what was left out of the skin.

    Raises CaseError if one cannot be read, its size is not that of a body in mm, there is no bone, or a bone
    lies in another piece of the skin's file than the largest.
    """
    assert case.imaging.skin is not None
    names = names_of_files(case.imaging.bones)
    paths = {SKIN: case.imaging.skin, **dict(zip(names, case.imaging.bones, strict=True))}
    surfaces = {name: _in_mm(_read(path, case.imaging), name, path) for name, path in paths.items()}
    if not case.imaging.bones:
        return _bodies(surfaces[SKIN], case.imaging.skin), paths, []
    bones = {name: surfaces[name] for name in names}
    surfaces[SKIN], inside = _without_bones(surfaces[SKIN], case.imaging.skin, bones)
    surfaces[SKIN], left_out = without_fragments(surfaces[SKIN], case.imaging.skin, bones)
    bodies, files = [_whole(each) for each in bones.values()], case.imaging.bones
    if names == numbered(len(names)):  # no file name identifies its bone
        if len(bodies) == 1:
            bodies = _single_bones(bodies[0])
            files = files * len(bodies)
        names = names_of_bodies(surfaces[SKIN], bodies)
    paths = {SKIN: case.imaging.skin, **dict(zip(names, files, strict=True))}
    surfaces = {SKIN: surfaces[SKIN], **dict(zip(names, bodies, strict=True))}
    return surfaces, paths, [*inside, *left_out]


def _without_bones(
    skin: Triangles, path: Path, bones: Mapping[str, Triangles]
) -> tuple[Triangles, list[str]]:
    """The skin without the triangles of bones that its file holds too, and a warning that names these bones.

    Where a scan was cut, skin and bones share points, and would be taken for one body.
    """
    kept, named = np.ones(len(skin.faces), bool), []
    for name, bone in bones.items():
        low, high = bone.points.min(axis=0) - _SAME_MM, bone.points.max(axis=0) + _SAME_MM
        near = np.flatnonzero(((skin.centroids >= low) & (skin.centroids <= high)).all(axis=1))
        far, which = cKDTree(skin.centroids[near]).query(bone.centroids, distance_upper_bound=_SAME_MM)
        same = near[which[np.isfinite(far)]]
        if len(same) > _HELD * len(bone.faces):
            kept[same] = False
            named.append(name)
    if not named or not kept.any():
        return skin, []
    there = f"{path.name} also holds {' and '.join(named)}, which the case gives separately"
    return skin.part(kept), [f"{there}: left out of the skin"]


def without_fragments(
    skin: Triangles, path: Path, bones: Mapping[str, Triangles]
) -> tuple[Triangles, list[str]]:
    """The largest piece of a skin's file with what lies inside it, and warnings that name the other pieces.

    Raises CaseError if a bone lies in one of the other pieces.
    """
    body, others = largest_and_fragments(skin)
    for each in others:
        inside = [name for name, bone in bones.items() if lies_within(bone, each)]
        if inside:
            raise CaseError(
                f"{' and '.join(inside)} lies in {_piece(each)} of the skin's file, which is not its largest",
                where=str(path),
                fix="give the skin of one limb, as one connected surface, and its own bones",
            )
    if not others:
        return skin, []
    named = "; ".join(_piece(each) for each in others[:_NAMED])
    more = f"; and {len(others) - _NAMED} smaller" if len(others) > _NAMED else ""
    what = f"{path.name} holds {len(others)} more piece{'s' if len(others) > 1 else ''} outside its largest"
    return body, [f"{what}, left out: {named}{more}"]


def _piece(piece: Triangles) -> str:
    """Size and place of a piece, in words."""
    low, high = piece.points.min(axis=0), piece.points.max(axis=0)
    return f"a piece {np.ptp(piece.points, axis=0).max():.0f} mm across at {triple(0.5 * (low + high))} mm"


def _bodies(surface: Triangles, path: Path) -> dict[str, Triangles]:
    """Skin and bones from a single file that contains all of them."""
    skin, *bones = skin_and_bones(surface)
    if not bones:
        raise CaseError(
            "the skin's file contains only one body, and no bones are given",
            where=str(path),
            fix='add `bones = ["file", ...]` to [imaging], or give all bodies in one file; of a scan of '
            'the skin say bone = "from-ultrasound"',
        )
    return {SKIN: skin, **dict(zip(names_of_bodies(skin, bones), bones, strict=True))}


def _single_bones(bones: Triangles) -> list[Triangles]:
    """The bodies of a file of bones, if each is large enough to be one; else all as one."""
    bodies = without_cavities(skin_and_bones(bones))
    return bodies if all(enclosed(each) > LEAST_BONE for each in bodies) else [bones]


def _whole(bone: Triangles) -> Triangles:
    """The bone without the inner surfaces of its cavities."""
    pieces = skin_and_bones(bone)
    kept = without_cavities(pieces)
    return bone if len(kept) == len(pieces) else join(kept)


def _read(path: Path, imaging: Imaging) -> Triangles:
    """The surface of a file, converted as the file states and as case.toml says.

    Raises CaseError if it cannot be read, or file and case give different units.
    """
    surface = read_surface(path)
    factor = _factor(path, imaging)
    points = surface.points * factor * ((-1.0, 1.0, 1.0) if imaging.mirrored else (1.0, 1.0, 1.0))
    found = Triangles(points, surface.faces)
    return found.flipped() if imaging.mirrored else found


def _factor(path: Path, imaging: Imaging) -> float:
    """By how much the lengths of a file, as it was read, are to be multiplied."""
    if imaging.mm_per_unit is None:
        return 1.0
    stated = stated_frame(path)
    contradicts = stated.mm_per_unit != 1.0 or (imaging.unit and stated.unit)
    if not contradicts:
        return imaging.mm_per_unit
    if stated.mm_per_unit == imaging.mm_per_unit:
        return 1.0
    key = f'unit = "{imaging.unit}"' if imaging.unit else f"scale = {imaging.mm_per_unit:g}"
    raise CaseError(
        f"{path.name} states its lengths in units of {stated.unit}, but case.toml says {key}",
        where=str(path),
        fix="remove the key from [imaging], or correct the header of the file",
    )


def _by_case(imaging: Imaging) -> list[str]:
    """What case.toml says of the surfaces, as lines."""
    lines = []
    if imaging.mm_per_unit not in (None, 1.0):
        unit = f" ({imaging.unit})" if imaging.unit else ""
        lines.append(f"lengths of the surfaces: 1 is {imaging.mm_per_unit:g} mm{unit}, as case.toml says")
    if imaging.mirrored:
        lines.append(
            "the surfaces show the other limb, as case.toml says: they were mirrored (x to -x); positions "
            "of sites are those of the mirrored limb"
        )
    return lines


def _in_mm(surface: Triangles, name: str, path: Path) -> Triangles:
    """Check a surface's size, and return it with the triangles of a drawn body divided."""
    size = np.ptp(surface.points, axis=0).max()
    if not 5.0 < size < 2000.0:
        converted = stated_frame(path).converted
        raise CaseError(
            f"the surface `{name}` is {size:.3g} mm across" + (f" ({converted})" if converted else ""),
            where=str(path),
            fix="save it in mm (patient LPS frame), or give its `unit` or `scale` in [imaging]",
            size_mm=float(size),
        )
    if not _is_drawn(surface):
        return surface
    return Triangles(*divided(surface.points, surface.faces, _LONGEST_EDGE))


def _is_drawn(surface: Triangles) -> bool:
    """Whether most of its area lies in triangles with long edges."""
    corners = surface.points[surface.faces]
    edges = corners - np.roll(corners, 1, axis=1)
    long = np.linalg.norm(edges, axis=2).max(axis=1) > _LONGEST_EDGE
    area = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    return bool(area[long].sum() > _DRAWN_SHARE * area.sum())


def read_body(path: Path, imaging: Imaging = _AS_STATED) -> tuple[Triangles, list[str]]:
    """The skin of a file as given, with outward normals, and warnings; imaging : its unit and side.

    Raises CaseError if it cannot be read, or its size is not that of a limb in mm.
    """
    surface, left_out = without_fragments(_in_mm(_read(path, imaging), "skin", path), path, {})
    turned, warnings = _turned(surface, "skin", path)
    return turned, [*left_out, *warnings]


def _usable(surface: Triangles, name: str, path: Path, writer: StageWriter) -> Triangles:
    """The surface with outward normals; an open one gives a warning (meshing closes it)."""
    surface, warnings = _turned(surface, name, path)
    writer.warnings.extend(warnings)
    return surface


def _turned(surface: Triangles, name: str, path: Path) -> tuple[Triangles, list[str]]:
    warnings = []
    if not surface.is_closed:
        warnings.append(
            f"{name} ({path.name}) is not closed{_rims(surface)}; it will be closed when the model is cut"
        )
    if turned_inward(skin_and_bones(surface)[0]):
        surface = surface.flipped()
        warnings.append(f"the normals of {path.name} pointed inward and were reversed")
    return surface, warnings


def _rims(surface: Triangles) -> str:
    """Where a surface is open, in words; the model has a flat lid there."""
    rims = [rim for each in skin_and_bones(surface) for rim in open_rims(each)]
    if not rims:
        return ""
    middle, width = max(rims, key=lambda each: each[1])
    several = f", {len(rims)} open rims" if len(rims) > 1 else ""
    return f" (an opening of {width:.0f} mm at {triple(middle)} mm{several})"


def write_skin_aop(case: Case, writer: StageWriter) -> None:
    """Write skin.aop of the skin that was written, with the markers as landmarks; warn where it cannot be."""
    skin = read_surface(writer.work / f"{SKIN}.ply")
    marks = {f"MARKER {each['number']}": np.array(each["position_mm"]) for each in writer.data["markers"]}
    write_upright_aop(skin_and_bones(skin)[0], marks, case.limb or "", writer, frame="patient LPS")


def write_upright_aop(
    body: Triangles, marks: Mapping[str, Array], side: str, writer: StageWriter, *, frame: str
) -> None:
    """Write skin.aop of a limb that stands upright, or warn why not.

    body, marks (3,) : mm, x to the left, y to the back, z along the limb to proximal; frame : in words
    """
    try:
        limb, axis = aop_limb(body.points, body.faces, side=side, landmarks=marks)
    except MeshError as error:
        writer.warnings.append(f"{AOP_FILE} was not written: {error.what}; {error.fix}")
        return
    place = f"height 0 of its axis is at {triple(axis)} mm ({frame})"
    write_aop(writer.file("aop", AOP_FILE), limb, comments=("limbcli", place))
    writer.summary.append(
        f"{AOP_FILE}: {len(limb.heights)} slices over {np.ptp(limb.heights):.0f} mm; {place}"
    )


def write_surfaces(surfaces: dict[str, Triangles], writer: StageWriter) -> None:
    """Write skin.ply and bone_*.ply, and record the volumes that they enclose."""
    volumes = {}
    for name, surface in surfaces.items():
        write_surface(writer.file(name, f"{name}.ply"), surface)
        bodies = skin_and_bones(surface)[: 1 if name == SKIN else None]
        volumes[name] = sum(enclosed(each) for each in bodies) / 1e3
        writer.summary.append(f"{name}: {volumes[name]:.1f} cm3, {len(surface.faces)} triangles")
    writer.data["volume_cm3"] = volumes
