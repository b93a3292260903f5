"""Identification of bones, by the file's name or by sizes and positions."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from limbcli.imaging.bones import names_by_size_and_place
from limbcli.meshing.mending import enclosed, long_axis
from limbcli.meshing.surfaces import Triangles
from limbcli.model.patient_frame import toward_head

_KNOWN = ("tibia", "fibula", "femur", "patella")


def names_of_files(paths: Sequence[Path]) -> list[str]:
    """Names such as bone_tibia if the file's name contains the bone, else bone_1, bone_2 ..."""
    names: list[str] = []
    for number, path in enumerate(paths, 1):
        known = [each for each in _KNOWN if each in path.stem.lower()]
        name = f"bone_{known[0] if len(known) == 1 else number}"
        names.append(name if name not in names else f"bone_{number}")
    return names


def names_of_bodies(skin: Triangles, bones: Sequence[Triangles]) -> list[str]:
    """bone_tibia, ... in the order of the bones if all can be identified, else bone_1, bone_2 ...

    skin, bones : mm, patient LPS
    """
    axis = toward_head(long_axis([skin, *bones]))
    volumes = np.array([abs(enclosed(each)) for each in bones])
    order = np.argsort(-volumes, kind="stable")
    ordered = [bones[n] for n in order]
    spans = [_span(each, axis) for each in ordered]

    def in_front(small: int, large: int) -> bool:
        low, high = spans[small]
        height = ordered[large].centroids @ axis
        same = ordered[large].centroids[(height >= low) & (height < high)]
        middle = same if len(same) else ordered[large].centroids
        return bool(ordered[small].centroids[:, 1].mean() < middle[:, 1].mean())  # LPS: anterior is -y

    names = [""] * len(bones)
    for n, name in zip(order, names_by_size_and_place(volumes[order], spans, in_front), strict=True):
        names[n] = f"bone_{name}"
    return names if not any(each[-1].isdigit() for each in names) else numbered(len(bones))


def numbered(n_bones: int) -> list[str]:
    return [f"bone_{number}" for number in range(1, n_bones + 1)]


def _span(bone: Triangles, axis: np.ndarray) -> tuple[float, float]:
    height = bone.points @ axis
    return float(height.min()), float(height.max())
