"""Interfaces of skin, fat and muscle on B-mode images, tracked through the force levels like the bone line.

The interface at the first level is marked by hand: which of several bright lines in fat is the fascia cannot
be determined reliably from one image. From there the strip around it is matched in the next image.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from limbcli.errors import MeasurementError
from limbcli.measurement.bmode import BoneLine, follow_line
from limbcli.measurement.ultrasound_image import UltrasoundImage

_BY_HAND = 0.2  # mm: standard deviation of an interface marked by hand
_HALF = 1.2  # half height of the template, mm: small, because adjacent layers are strained differently
_LARGEST_CHANGE = 4.0  # search range between adjacent levels, mm
_APART = 0.2  # smallest distance between interfaces, mm

Stated = float | Sequence[float]


def follow_borders(
    images: Sequence[UltrasoundImage], stated: Mapping[str, Stated], bone: Sequence[BoneLine]
) -> dict[str, list[BoneLine]]:
    """Depth of the lower interface of each layer below the probe face at every level, by the layer's name.

    stated : thickness (mm) of skin, then of fat, at the first level (it is then tracked) or at every level
    bone : the bone line at every level

    Raises MeasurementError if fat is given without skin, an interface is lost, or interfaces cross each other
    or the bone.
    """
    if stated and next(iter(stated)) != "skin":
        raise MeasurementError(
            "fat_mm is stated without skin_mm", where="[site.b_mode]",
            fix="also state skin_mm: the fat begins where the skin ends",
        )  # fmt: skip
    found: dict[str, list[BoneLine]] = {}
    above: list[float] = [0.0] * len(images)
    for name, thickness in stated.items():
        if isinstance(thickness, Sequence):
            lines = _by_hand(images, name, thickness, above)
        else:
            lines = _followed(images, name, above[0] + float(thickness))
        # the interfaces must be in order down to the bone
        for image, line, top, end in zip(images, lines, above, bone, strict=True):
            if not top + _APART <= line.distance <= end.distance - _APART:
                raise MeasurementError(
                    f"the border of the {name} would be {line.distance:.1f} mm below the probe face, between "
                    f"{top:.1f} mm (what lies above) and the bone at {end.distance:.1f} mm: interfaces cross",
                    where=image.where,
                    fix=f"check {name}_mm of level 0, or state it for every level as a list",
                )
        found[name], above = lines, [each.distance for each in lines]
    return found


def _followed(images: Sequence[UltrasoundImage], name: str, first: float) -> list[BoneLine]:
    lines = [BoneLine(first, _BY_HAND, 1.0)]
    for previous, image in pairwise(images):
        line = follow_line(
            previous, image, lines[-1], min(_LARGEST_CHANGE, lines[-1].distance),
            name=f"border of the {name}", by_hand=f"{name}_mm, a list in [site.b_mode]", half=_HALF,
        )  # fmt: skip
        lines.append(replace(line, sd=float(np.hypot(line.sd, lines[-1].sd))))
    return lines


def _by_hand(
    images: Sequence[UltrasoundImage], name: str, thickness: Sequence[float], above: Sequence[float]
) -> list[BoneLine]:
    if len(thickness) != len(images):
        raise MeasurementError(
            f"{name}_mm states {len(thickness)} thicknesses, there are {len(images)} images",
            where=str(images[0].path.parent), fix="state one per image, or only that of the first",
        )  # fmt: skip
    return [BoneLine(top + float(each), _BY_HAND, 1.0) for top, each in zip(above, thickness, strict=True)]
