"""Identify bones by size and position."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from limbcli.imaging.volume import Volume
from limbcli.model import Array

_CLEARLY_LARGER = 1.5
# two bones are side by side if they overlap over more than this fraction of the shorter one's height
_BESIDE = 0.5
# two bones are above each other if they overlap over less than this fraction of the shorter one's height
_JOINT = 0.35


def name_bones(bones: tuple[Volume, ...]) -> tuple[str, ...]:
    """Name bones tibia, fibula, femur, patella by size and position, else by number.

    See `names_by_size_and_place`.

    bones : Volumes of bool, largest first, k along the limb towards proximal
    """
    return names_by_size_and_place(
        np.array([bone.values.sum() for bone in bones], float),
        [_span(bone) for bone in bones],
        lambda small, large: _in_front(bones[small], bones[large]),
    )


def names_by_size_and_place(
    sizes: Array, spans: Sequence[tuple[float, float]], in_front: Callable[[int, int], bool]
) -> tuple[str, ...]:
    """Names tibia, fibula, femur, patella if size and position determine them; otherwise numbers.

    Side by side along the limb are the tibia (the larger) and the fibula; a large bone above them (towards
    proximal) is the femur, a small one in front of the joint the patella. A single bone, or a set that fits
    none of this, is numbered.

    sizes : (n,) volumes in any unit, largest first
    spans : n height ranges along the limb, from distal to proximal, in any unit
    in_front : whether the bone of the first number lies anterior to that of the second
    """
    numbers = tuple(f"{n + 1}" for n in range(len(sizes)))
    if len(sizes) < 2:
        return numbers
    names: dict[int, str] = {}
    lower, femur = _shank_and_thigh(sizes, spans)
    if femur is not None:
        names[femur] = "femur"
    if lower:
        names[lower[0]] = "tibia"
    if len(lower) > 1:
        names[lower[1]] = "fibula"
    rest = [n for n in range(len(sizes)) if n not in names]
    if femur is not None and len(rest) == 1 and in_front(rest[0], femur):
        names[rest[0]] = "patella"
        rest = []
    if rest or not lower:
        return numbers
    return tuple(names[n] for n in range(len(sizes)))


def _span(bone: Volume) -> tuple[int, int]:
    filled = np.flatnonzero(bone.values.any(axis=(0, 1)))
    return int(filled[0]), int(filled[-1]) + 1


def _overlap(a: tuple[float, float], b: tuple[float, float]) -> float:
    """Common height range as a fraction of the shorter one."""
    common = min(a[1], b[1]) - max(a[0], b[0])
    return max(common, 0) / min(a[1] - a[0], b[1] - b[0])


def _shank_and_thigh(sizes: Array, spans: Sequence[tuple[float, float]]) -> tuple[list[int], int | None]:
    """Numbers of tibia and fibula, and of the femur; fewer if they are not in view."""
    large = [n for n in range(len(sizes)) if sizes[n] > 0.25 * sizes[0]]
    femur = None
    tibia = large[0]
    for other in large[1:]:
        if _overlap(spans[tibia], spans[other]) <= _JOINT:
            low, high = sorted((tibia, other), key=lambda n: spans[n][0])
            tibia, femur = low, high
            break
    beside = [
        n
        for n in range(len(sizes))
        if n not in (tibia, femur)
        and _overlap(spans[tibia], spans[n]) >= _BESIDE
        and sizes[tibia] > _CLEARLY_LARGER * sizes[n]
        and (femur is None or _overlap(spans[femur], spans[n]) <= _JOINT)
    ]
    return ([tibia, *beside[:1]] if beside or femur is not None else []), femur


def _in_front(bone: Volume, femur: Volume) -> bool:
    """Whether a bone lies anterior (patient LPS: smaller y) to the centre of another at the same height."""
    centre = _centre(bone, bone.values)
    low, high = _span(bone)
    same_height = femur.values.copy()
    same_height[:, :, :low] = same_height[:, :, high:] = False
    other = _centre(femur, same_height if same_height.any() else femur.values)
    return bool(centre[1] < other[1])


def _centre(volume: Volume, mask: np.ndarray) -> Array:
    return volume.to_patient(np.argwhere(mask).mean(axis=0)[None])[0]
