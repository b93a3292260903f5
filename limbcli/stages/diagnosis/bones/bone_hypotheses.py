"""Alternative bones of a limb: without a small bone near the probe, or with misplaced bones put back."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from limbcli.case import Case, Site
from limbcli.diagnostics import thresholds
from limbcli.meshing.frame import site_frame
from limbcli.meshing.probe import ProbeShape
from limbcli.meshing.surfaces import Triangles, read_surface
from limbcli.model import Array
from limbcli.results import StageResult
from limbcli.stages.mesh import read_limb, site_position

_MINOR = 0.25  # fraction of the volume of all bones below which a bone may be absent; a larger one may not
_AS_NEAR = 10.0  # mm beyond the distance of the nearest other bone, within which a bone affects the force


@dataclass(frozen=True, eq=False)
class OtherBones:
    """A limb with changed bones.

    left_out : names; moved : by name, shift (3,) in mm, patient LPS; needed : smallest reduction of deviance
    at which the readings outweigh the segmented surfaces
    """

    words: str
    needed: float
    left_out: tuple[str, ...] = ()
    moved: Mapping[str, Array] = field(default_factory=dict)

    @property
    def is_repair(self) -> bool:
        """Whether the change corrects bones that are known to be misplaced."""
        return bool(self.moved)

    def of(self, name: str, bone: Triangles) -> Triangles | None:
        """The bone as it is in this limb; None if it is left out."""
        if name in self.left_out:
            return None
        shift = np.eye(4)
        shift[:3, 3] = self.moved.get(name, np.zeros(3))
        return bone.moved(shift)


def questions(case: Case, sites: Sequence[Site], segmented: StageResult) -> list[OtherBones]:
    """Limbs with changed bones that would affect the measurements at these sites; usually none.

    Raises
    ------
    CaseError, MeshError
        If a site or the limb cannot be used.
    """
    bones = {name: read_surface(segmented.path(name)) for name in segmented.files if name.startswith("bone_")}
    wrong = segmented.data.get("misplaced", {})
    misplaced = tuple(name for name in wrong.get("bones", ()) if name in bones)
    right = {name: each for name, each in bones.items() if name not in misplaced}
    frames = _frames(case, sites, segmented)
    whole = sum(abs(each.volume) for each in bones.values())
    found = []
    minor = {name: each for name, each in right.items() if abs(each.volume) < _MINOR * whole}
    for name in _in_reach(minor, right, frames, case.probe.length, case.probe.width)[:1]:
        found.append(OtherBones(f"without {name}", thresholds.BONES_SEEN, left_out=(name,)))
    if misplaced and "move_mm" in wrong:
        move = np.asarray(wrong["move_mm"], float)
        back = OtherBones(
            f"with {' and '.join(misplaced)} put back within the skin", thresholds.BONES_MISPLACED,
            moved=dict.fromkeys(misplaced, move),
        )  # fmt: skip
        there = {name: moved for name in misplaced if (moved := back.of(name, bones[name])) is not None}
        if _in_reach(there, {**right, **there}, frames, case.probe.length, case.probe.width):
            found.append(back)
    return found


def _frames(case: Case, sites: Sequence[Site], segmented: StageResult) -> list[Array]:
    """Transform (4, 4) from patient LPS to the probe's frame, for each site."""
    limb = read_limb(segmented)
    probe = ProbeShape(case.probe.length, case.probe.width, case.probe.edge_radius)
    return [
        site_frame(limb, np.array(site_position(site, segmented)), site.long_axis, probe).to_model
        for site in sites
    ]


def _in_reach(
    candidates: Mapping[str, Triangles], bones: Mapping[str, Triangles], frames: Sequence[Array],
    length: float, width: float,
) -> list[str]:  # fmt: skip
    """Candidates about as near to a probe's face as the nearest other bone, the nearest first."""
    nearest: dict[str, float] = {}
    for frame in frames:
        far = {name: _from_face(each.moved(frame).points, length, width) for name, each in bones.items()}
        for name in candidates:
            others = [distance for other, distance in far.items() if other not in candidates]
            if others and far[name] < min(others) + _AS_NEAR:
                nearest[name] = min(far[name], nearest.get(name, np.inf))
    return sorted(nearest, key=lambda name: nearest[name])


def _from_face(points: Array, length: float, width: float) -> float:
    """Distance (mm) from a probe's face of this length (along x) and width (along y) to the nearest point."""
    beside = np.maximum(np.abs(points[:, :2]) - np.array([length, width]) / 2, 0.0)
    return float(np.linalg.norm(np.column_stack([beside, points[:, 2]]), axis=1).min())
