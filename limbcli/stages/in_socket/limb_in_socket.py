"""A limb's model and the inner face of its socket, in the limb's own upright frame (z along its axis)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from limbcli.case.socket import KneeInput, SocketInput
from limbcli.errors import CaseError
from limbcli.meshing.limb_parts import LimbFrame
from limbcli.meshing.surfaces import Triangles, merge_points, read_surface
from limbcli.meshing.whole_limb import HELD
from limbcli.model import Array, LimbModel
from limbcli.results import StageWriter
from limbcli.sockets.alignment import Alignment, align, by_landmarks, mirror_image_warning
from limbcli.sockets.centre_line import CentreLine, centre_line, own_line
from limbcli.sockets.checks import (
    Clearance,
    check_around,
    check_near,
    check_openings,
    check_room,
    check_size,
    clearance,
)
from limbcli.sockets.inner_face import inner_face
from limbcli.sockets.knee import KneeLoad, check_knee, knee_centre
from limbcli.sockets.liner import LINER, Liner, with_liner
from limbcli.sockets.rectification import LIP_MM, Rectification, along_curves, rectified

TO_TIP = np.array([0.0, 0.0, -1.0])
PATCH, _LANDMARK, _TIBIA = "patch_", "landmark_", "bone_tibia"
_BELOW_CUT_MM = 20.0  # a socket made from the skin ends this far below the proximal cut
_NEAR_CUT_MM = 15.0  # the held cut disturbs the pressures this far


@dataclass(frozen=True, eq=False, kw_only=True)
class LimbInSocket:
    """limb : upright; skin : its facets, flat between their corners

    face : inner face, normals towards the limb; fit : clearances before donning
    alignment : None where the surface was not moved; words : what the socket is
    touching : name of the surface that meets the socket: the skin or the liner
    slides : whether a liner slides on the skin; pressures are then those on the skin
    knee : shear and moment at the knee centre, or None
    """

    limb: LimbModel
    frame: LimbFrame
    skin: Triangles
    face: Triangles
    fit: Clearance
    words: str
    alignment: Alignment | None = None
    touching: str = "skin"
    slides: bool = False
    knee: KneeLoad | None = None

    @property
    def pressed(self) -> str:
        """Name of the surface that bears the pressures."""
        return "skin" if self.slides else self.touching

    @property
    def behind(self) -> str:
        """What lies behind a face that it meets, for messages."""
        return "skin and liner lie" if self.slides else f"the {self.touching} lies"

    def in_lps(self, points: Array) -> Array:
        """Points (n, 3) of the upright frame in patient LPS."""
        return np.asarray(points @ _turn(self.frame) + self.frame.origin)

    def directions_in_lps(self, vectors: Array) -> Array:
        """The same of vectors (n, 3), which have no origin."""
        return np.asarray(vectors @ _turn(self.frame))


def frame_of(model: LimbModel) -> LimbFrame:
    """The frame that the stage `limb` put into its model."""
    stored = model.info["frame"]
    origin, axis, anterior, lateral = (
        np.array(stored[f"{name}_lps"]) for name in ("origin", "axis", "anterior", "lateral")
    )
    return LimbFrame(origin, axis, anterior, lateral, float(stored["length_mm"]))


def put_together(model: LimbModel, given: SocketInput, writer: StageWriter) -> LimbInSocket:
    """The limb and its socket, checked.

    Raises CaseError or MeshError if the socket does not fit the limb; each reason has its own message.
    """
    frame = frame_of(model)
    bodies = tuple(
        replace(each, center_of_mass=tuple(frame.upright(np.array([each.center_of_mass]))[0].tolist()))
        for each in model.bodies
    )
    mesh = replace(model.mesh, points=frame.upright(model.mesh.points))
    limb = replace(model, mesh=mesh, bodies=bodies)
    skin = along_curves(limb.mesh.points, next(iter(limb.mesh.surfaces["skin"].facets.values()))[:, :3])
    line = centre_line(skin, TO_TIP)
    bare, touching, of_liner = _curved(limb, "skin"), "skin", ""
    if given.liner is not None:
        liner = given.liner
        made = Liner(
            thickness=liner.thickness, youngs_modulus=liner.youngs_modulus, poisson=liner.poisson,
            bonded=liner.bonded,
        )  # fmt: skip
        limb, touching = with_liner(limb, made), LINER
        how = "is bonded to" if liner.bonded else "slides on"
        of_liner = f"; a liner of {liner.thickness:g} mm {how} the skin"
    outside = _curved(limb, touching)
    alignment = None
    if given.surface is None:
        face, words = _from_skin(limb, outside, given)
    else:
        face, alignment = _from_file(limb, frame, outside, line, given, writer)
        words = f"inner face of {given.surface.name}"
    where = "[socket]" if given.surface is None else str(given.surface)
    check_around(face, line, where=where)
    fit = clearance(face, outside, line, where=where)
    lip = LIP_MM if given.surface is None and given.flare else 0.0
    _warn_at_cut(limb, face, lip, writer)
    if given.liner is not None and given.surface is not None:
        check_room(clearance(face, bare, line, where=where), bare, given.liner.thickness)
    knee = None if given.knee is None else _knee_load(limb, frame, line, given.knee)
    return LimbInSocket(
        limb=limb, frame=frame, skin=skin, face=face, fit=fit,
        words=words + of_liner,
        alignment=alignment, touching=touching, knee=knee,
        slides=given.liner is not None and not given.liner.bonded,
    )  # fmt: skip


def _knee_load(limb: LimbModel, frame: LimbFrame, line: CentreLine, given: KneeInput) -> KneeLoad:
    """What acts on the socket: the opposite of what the thigh does to the limb."""
    if given.centre is not None:
        centre = frame.upright(np.array([given.centre]))[0]
        check_knee(centre, line)
    else:
        tibia = limb.mesh.node_sets.get(_TIBIA, np.zeros(0, np.int64))
        found = knee_centre(limb.mesh.points[tibia], _top(limb)) if len(tibia) else None
        if found is None:
            raise CaseError(
                "the knee centre is not known: the limb shows no upper end of a tibia",
                where="[socket.knee]", fix="give centre_mm = [x, y, z], mm, patient LPS",
            )  # fmt: skip
        centre = found
    anterior, lateral = -np.eye(3)[1], lateral_of(frame)
    force = -(given.anterior * anterior + given.lateral * lateral)
    moment = -(given.about_anterior * anterior + given.about_lateral * lateral)
    x, y, z = (tuple(map(float, each)) for each in (centre, force, moment))
    return KneeLoad(x, y, z)  # type: ignore[arg-type]


def lateral_of(frame: LimbFrame) -> Array:
    """Unit vector (3,) of the upright frame towards the lateral side."""
    return np.asarray(frame.lateral @ np.cross(frame.axis, frame.anterior) * np.eye(3)[0])


def _turn(frame: LimbFrame) -> Array:
    """Rows: the axes of the upright frame in LPS."""
    return np.asarray(frame.upright(np.eye(3)) - frame.upright(np.zeros((1, 3)))).T


def _top(limb: LimbModel) -> float:
    """Height (mm) of the lowest point of the proximal cut."""
    facets = limb.mesh.surfaces["proximal_cut"].facets.values()
    nodes = np.unique(np.concatenate([each.ravel() for each in facets]))
    return float(limb.mesh.points[nodes, 2].min())


def facets_of_patches(limb: LimbModel) -> dict[str, NDArray[np.bool_]]:
    """By patch, which facets (n_facets,) of the skin belong to it."""
    skin = next(iter(limb.mesh.surfaces["skin"].facets.values()))
    rows = {tuple(sorted(each)): k for k, each in enumerate(skin[:, :3].tolist())}
    masks = {}
    for name, surface in limb.mesh.surfaces.items():
        if name.startswith(PATCH):
            mask = np.zeros(len(skin), bool)
            own = next(iter(surface.facets.values()))[:, :3].tolist()
            mask[[rows[tuple(sorted(each))] for each in own]] = True
            masks[name.removeprefix(PATCH)] = mask
    return masks


def _curved(limb: LimbModel, name: str) -> Triangles:
    """A surface of the limb with its curves."""
    return along_curves(limb.mesh.points, next(iter(limb.mesh.surfaces[name].facets.values())))


def _from_skin(limb: LimbModel, outside: Triangles, given: SocketInput) -> tuple[Triangles, str]:
    """outside : of skin or liner, its triangles in the order of the skin's facets"""
    top = _top(limb)
    brim = top - _BELOW_CUT_MM if given.brim is None else given.brim
    if brim > top:
        raise CaseError(
            f"the brim at {brim:g} mm lies above the proximal cut at {top:.0f} mm",
            where="socket.brim_mm", fix="give the height of the socket's end above the limb's lower end",
        )  # fmt: skip
    table = Rectification(
        patches_mm=given.rectifications,
        all_mm=given.all_mm,
        transition_mm=given.transition,
        brim_mm=-brim,
        flare_mm=given.flare,
    )
    patches = facets_of_patches(limb)
    found = {name: np.unique(outside.faces.reshape(len(own), -1)[own]) for name, own in patches.items()}
    face = rectified(outside, found, table, TO_TIP, where="[socket]")
    return (
        face,
        f"made from the skin up to {brim:.0f} mm, flared by {given.flare:g} mm there: {table.sentence}",
    )


def _from_file(
    limb: LimbModel, frame: LimbFrame, skin: Triangles, line: CentreLine, given: SocketInput,
    writer: StageWriter,
) -> tuple[Triangles, Alignment | None]:  # fmt: skip
    assert given.surface is not None
    where = str(given.surface)
    surface = merge_points(read_surface(given.surface))
    check_size(surface, skin, where=where)
    alignment = None
    if given.landmarks:
        own, on_limb = _pairs(limb, given.landmarks)
        alignment = by_landmarks(own, on_limb, names=list(given.landmarks), where="[socket.landmarks]")
        face = inner_face(surface.moved(alignment.transform), line, where=where)
        if told := mirror_image_warning(face, skin, on_limb):
            writer.warnings.append(f"{where}: {told}")
    elif given.align:
        unplaced = inner_face(surface, own_line(surface, where=where), where=where)
        alignment = align(unplaced, skin, line, where=where)
        face = unplaced.moved(alignment.transform)
    else:
        placed = Triangles(frame.upright(surface.points), surface.faces)
        check_near(placed, skin, where=where)
        face = inner_face(placed, line, where=where)
    check_openings(face, line, where=where)
    return face, alignment


def _pairs(limb: LimbModel, given: Mapping[str, tuple[float, float, float]]) -> tuple[Array, Array]:
    known = {
        name.removeprefix(_LANDMARK): limb.mesh.points[nodes[0]]
        for name, nodes in limb.mesh.node_sets.items()
        if name.startswith(_LANDMARK)
    }
    if unknown := [name for name in given if name not in known]:
        raise CaseError(
            f"the limb has no landmark {unknown[0]!r}",
            where="[socket.landmarks]",
            fix=f"use some of {', '.join(sorted(known))}, or `align = true`",
        )
    return np.array(list(given.values())), np.array([known[name] for name in given])


def _warn_at_cut(limb: LimbModel, face: Triangles, lip: float, writer: StageWriter) -> None:
    """lip : height of the part above the brim that rolls outward, mm"""
    held = limb.mesh.points[limb.mesh.node_sets[HELD], 2] if HELD in limb.mesh.node_sets else np.zeros(0)
    if len(held) and face.points[:, 2].max() - lip > held.min() - _NEAR_CUT_MM:
        writer.warnings.append(
            f"the socket comes within {_NEAR_CUT_MM:g} mm of the proximal cut, where the limb is held: "
            "pressures there are those of the cut, not of the limb"
        )
