"""The domain to be meshed: the tissue of a limb near a site, bounded by skin, bones and cuts.

Skin and bones are represented on the distance grid, where overlaps, clefts and bones that touch the skin are
resolved; the cuts are planes and stay sharp.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import manifold3d
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from skimage.measure import marching_cubes

from limbcli.errors import MeshError
from limbcli.meshing.crop import within
from limbcli.meshing.distance import Field, Grid, distance_again, grid_over, rounded, signed_distance
from limbcli.meshing.frame import closest_on_triangles
from limbcli.meshing.mending import Limb, Plane
from limbcli.meshing.surfaces import Triangles, join
from limbcli.model import Array, IntArray

SKIN, BONE, CUT = 1, 2, 3  # labels of boundary faces; the cut of plane k is CUT + k
CLEARANCE = 1.2  # mm of tissue kept between skin and bone
WEDGE = 2.5  # mm: tissue between bone and a cut is treated as bone where it is narrower than about twice this
CLEFT = 1.5  # mm: clefts between bones narrower than twice this are filled
_SMALL = 60.0  # mm3: smaller pieces of bone are discarded
_SPACING = 1.0  # mm, of the grid on which a bone is cut off at the skin
_SPECK = 0.05  # fraction of the largest piece of tissue: the site cannot lie in a smaller piece


@dataclass(frozen=True, eq=False)
class TissueDomain:
    """Distance fields of skin and bone in the site's frame, the cutting planes, and notes on repairs.

    whole : whether it is a whole limb: of separate pieces of tissue the largest is meant, not that at the
        site
    """

    skin: Field
    bone: Field | None
    planes: tuple[Plane, ...]
    notes: tuple[str, ...]
    whole: bool = False

    @cached_property
    def boundary(self) -> Triangles:
        """The closed boundary of the tissue, in triangles of about the grid's spacing.

        A bone that lies entirely inside (a patella) is a void: a separate component whose normals point into
        the bone.
        """
        return _boundary(self)

    def label(self, points: Array) -> IntArray:
        """The boundary on which points (n, 3) of the surface lie: SKIN, BONE or CUT + number of the plane."""
        distances = [np.abs(self.skin.at(points))]
        distances.append(np.abs(self.bone.at(points)) if self.bone else np.full(len(points), np.inf))
        distances += [np.abs(each.height(points)) for each in self.planes]
        return np.argmin(np.stack(distances), axis=0).astype(np.int64) + 1

    def smoothed(self, width: float) -> TissueDomain:
        """The domain with bones smoothed by a Gaussian of `width` mm, still clear of the skin."""
        if self.bone is None:
            return self
        values = ndimage.gaussian_filter(self.bone.values, width / self.bone.grid.spacing)
        values = np.maximum(values, self.skin.values + CLEARANCE)
        return replace(self, bone=distance_again(self.bone.with_values(values)))


def make_domain(
    limb: Limb, planes: tuple[Plane, ...], *, spacing: float = 1.0, whole: bool = False
) -> TissueDomain:
    """The tissue between skin, bones and planes, in the frame of the given limb.

    whole : of separate pieces of tissue, keep the largest, not the one at the origin (the site)

    Raises MeshError if no tissue is left at the origin (the site).
    """
    inside = within(limb.skin.points, planes, slack=2 * spacing)
    if not inside.any():
        raise MeshError(
            "nothing of the limb is left after the crop",
            where="site",
            fix="check position_mm and the surfaces",
        )
    grid = grid_over(*_reach(limb.skin, planes, 4.0 * spacing), spacing)
    notes: list[str] = []
    skin = signed_distance(limb.skin, grid)
    bones = [each for each in limb.bones if _meets(each, grid)]
    bone = None
    if bones:
        bone = _clear_of_skin(rounded(signed_distance(join(bones), grid), CLEFT), skin, planes, notes)
        bone = _one_tissue(_without_wedges(bone, planes), skin, planes, notes, whole=whole)
    return TissueDomain(
        skin, bone if bone is not None and (bone.values < 0).any() else None, planes, tuple(notes), whole
    )


def _reach(skin: Triangles, planes: tuple[Plane, ...], slack: float) -> tuple[Array, Array]:
    """Bounding box of the skin cut by the planes, enlarged by `slack`."""
    solid = manifold_of(skin, "skin", must=False)
    if solid is not None:
        for each in planes:
            solid = solid.trim_by_plane(tuple(-each.normal), -each.offset)
        box = np.array(solid.bounding_box())
        if np.isfinite(box).all():
            return box[:3] - slack, box[3:] + slack
    near = skin.points[within(skin.points, planes, slack=10.0)]
    return near.min(0) - slack, near.max(0) + slack


def _meets(surface: Triangles, grid: Grid) -> bool:
    low, high = grid.box
    return bool((surface.points.max(0) > low).all() and (surface.points.min(0) < high).all())


def _clear_of_skin(bone: Field, skin: Field, planes: tuple[Plane, ...], notes: list[str]) -> Field:
    """Push bone `CLEARANCE` below the skin; `notes` records by how much."""
    tight = (bone.values < 0) & (skin.values > -CLEARANCE)
    points = bone.grid.points()[tight]
    counted = within(points, planes, slack=-1.0)
    if counted.any():
        depth = float(skin.at(bone.project(points[counted])).max() + CLEARANCE)
        volume = int(counted.sum() * bone.grid.spacing**3)
        notes.append(
            f"bone came within {CLEARANCE:g} mm of the skin on {volume} mm3 "
            f"(by up to {depth:.1f} mm) and was pushed inside"
        )
    return distance_again(bone.with_values(np.maximum(bone.values, skin.values + CLEARANCE)))


def part_inside(bone: Triangles, skin: Triangles) -> Triangles | None:
    """The part of a bone that lies within a closed skin; None if it is too small to be meshed."""
    grid = grid_over(bone.points.min(0) - 2 * _SPACING, bone.points.max(0) + 2 * _SPACING, _SPACING)
    inside = np.maximum(signed_distance(bone, grid).values, signed_distance(skin, grid).values)
    if (inside < 0).sum() * _SPACING**3 < _SMALL:
        return None
    return _level_set(Field(grid, inside))


def _without_wedges(bone: Field, planes: tuple[Plane, ...]) -> Field:
    """Treat thin tissue between bone and a cut as bone: both are fixed, and its cells would be slivers."""
    if not planes:
        return bone
    points = bone.grid.points().reshape(-1, 3)
    beyond = np.max([each.height(points) for each in planes], axis=0).reshape(bone.grid.shape)
    filled = rounded(bone.with_values(np.minimum(bone.values, -beyond)), WEDGE)
    # The closing is reduced by half the radius, so that a right angle (filled 0.41 radii deep) is kept;
    # applied near bone only.
    wedge = np.maximum(filled.values + 0.5 * WEDGE, bone.values - 2 * WEDGE)
    return distance_again(bone.with_values(np.minimum(bone.values, wedge)))


def _one_tissue(
    bone: Field, skin: Field, planes: tuple[Plane, ...], notes: list[str], *, whole: bool
) -> Field:
    """Fill tissue pockets enclosed by bone, and discard specks of bone."""
    values = bone.values.copy()
    specks, n = ndimage.label(values < 0)
    sizes = ndimage.sum_labels(np.ones_like(values), specks, np.arange(1, n + 1)) * bone.grid.spacing**3
    for k in np.flatnonzero(sizes < _SMALL) + 1:
        values[specks == k] = 0.5 * bone.grid.spacing
    points = bone.grid.points().reshape(-1, 3)
    kept = np.asarray(within(points, planes), bool).reshape(values.shape)
    tissue = (values > 0) & (skin.values < 0) & kept
    pockets, n = ndimage.label(tissue)
    if n > 1:
        piece = int(np.argmax(np.bincount(pockets[tissue]))) if whole else _piece_at_site(pockets, n, points)
        shut = tissue & (pockets != piece)
        values[shut] = -0.5 * bone.grid.spacing
        notes.append(f"{n - 1} pockets ({int(shut.sum() * bone.grid.spacing**3)} mm3) shut in by bone filled")
    return bone.with_values(values)


def _piece_at_site(pieces: NDArray[Any], n: int, points: Array) -> int:
    """Number of the piece of tissue nearest to the site (the origin), ignoring specks."""
    numbers = np.arange(1, n + 1)
    sizes = ndimage.sum_labels(np.ones_like(pieces), pieces, numbers)
    distance = np.linalg.norm(points, axis=1).reshape(pieces.shape)
    nearest = ndimage.minimum(distance, pieces, numbers)
    nearest = np.where(sizes > _SPECK * sizes.max(), nearest, np.inf)
    return int(numbers[np.argmin(nearest)])


def _boundary(domain: TissueDomain) -> Triangles:
    solid = manifold_of(_level_set(domain.skin), "skin")
    assert solid is not None
    if domain.bone is not None:
        bone = manifold_of(_level_set(domain.bone), "bone")
        assert bone is not None
        solid = solid - bone
    solid = solid.simplify(0.02)
    for each in domain.planes:
        solid = solid.trim_by_plane(tuple(-each.normal), -each.offset)
    pieces = solid.decompose()
    bodies = [_triangles(each) for each in pieces if each.volume() > 0]
    if not bodies:
        raise MeshError(
            "no tissue is left after the crop", where="site", fix="check position_mm and the surfaces"
        )
    whole = max(each.volume for each in bodies)
    if domain.whole:
        body = max(bodies, key=lambda each: each.volume)
    else:
        body = min((each for each in bodies if each.volume > _SPECK * whole), key=_distance_from_site)
    voids = [_triangles(each) for each in pieces if each.volume() < 0]  # bones that no cut intersects
    return join([body, *(each for each in voids if _lies_within(each, body))])


def _triangles(solid: manifold3d.Manifold) -> Triangles:
    mesh = solid.to_mesh64()
    return Triangles(np.array(mesh.vert_properties[:, :3], float), np.array(mesh.tri_verts, np.int64))


def _distance_from_site(body: Triangles) -> float:
    return float(np.linalg.norm(closest_on_triangles(np.zeros(3), body.corners), axis=1).min())


def _lies_within(void: Triangles, body: Triangles) -> bool:
    low, high = body.points.min(axis=0), body.points.max(axis=0)
    return bool(((void.points > low) & (void.points < high)).all())


def _level_set(field: Field) -> Triangles:
    """The zero level as a triangle surface, closed at the grid's border."""
    values = np.pad(field.values, 1, constant_values=field.grid.spacing)
    values = np.where(np.abs(values) < 1e-3 * field.grid.spacing, 1e-3 * field.grid.spacing, values)
    points, faces, _, _ = marching_cubes(values, 0.0, spacing=(field.grid.spacing,) * 3)
    points = points + field.grid.origin - field.grid.spacing
    surface = Triangles(points.astype(float), faces.astype(np.int64))
    return surface if surface.volume > 0 else surface.flipped()


def manifold_of(surface: Triangles, name: str, *, must: bool = True) -> manifold3d.Manifold | None:
    """The surface as a solid for exact cutting; if it is not closed, None, or MeshError with `must`."""
    mesh = manifold3d.Mesh64(
        np.ascontiguousarray(surface.points, np.float64), np.ascontiguousarray(surface.faces, np.uint64)
    )
    solid = manifold3d.Manifold(mesh)
    if solid.status() == manifold3d.Error.NoError:
        return solid
    if not must:
        return None
    raise MeshError(
        f"the {name} surface is not a closed body ({solid.status()})",
        where=name,
        fix="smooth the segmentation slightly, or give a closed surface",
    )
