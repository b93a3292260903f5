"""Label maps in the formats that segmentation programs write, brought to our labels.

NIfTI and plain NRRD hold our numbers already (1 soft tissue, 2 bone, 3 marker, 4 fat);
`.seg.nrrd` and DICOM SEG name their segments, and the names decide.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from limbcli.errors import CaseError
from limbcli.imaging.dicom_seg import read_dicom_seg
from limbcli.imaging.labels import checked_labels, read_labels
from limbcli.imaging.nrrd import Nrrd, read_nrrd
from limbcli.imaging.segmentation import BONE, FAT, MARKER, SOFT_TISSUE
from limbcli.imaging.volume import Volume

_WORDS = (
    (MARKER, ("marker", "capsule", "fiducial", "pinpoint")),
    (BONE, ("bone", "tibia", "fibula", "femur", "patella", "knochen", "cortex", "marrow")),
    (FAT, ("fat", "adipose", "subcut")),
    (SOFT_TISSUE, ("soft", "skin", "muscle", "tissue", "limb", "leg", "flesh", "stump")),
)
_ORDER = (SOFT_TISSUE, FAT, BONE, MARKER)  # a later one lies over an earlier one


def read_label_file(path: Path) -> Volume:
    """A label map from NIfTI, NRRD, `.seg.nrrd` or DICOM SEG, in patient LPS.

    Raises
    ------
    CaseError
        If the file cannot be read, or its values or names are not understood.
    """
    name = path.name.lower()
    if name.endswith((".nrrd", ".nhdr")):
        nrrd = read_nrrd(path)
        segments = _segments(nrrd)
        if not segments:
            return checked_labels(Volume(nrrd.values, nrrd.affine), path)
        named = [(title, nrrd_layer == value) for title, nrrd_layer, value in segments]
        return checked_labels(Volume(by_name(named, path), nrrd.affine), path)
    if name.endswith((".dcm", ".ima")):
        masks = read_dicom_seg(path)
        return checked_labels(Volume(by_name(masks.named, path), masks.affine), path)
    return read_labels(path)


def by_name(segments: Sequence[tuple[str, NDArray[np.bool_]]], path: Path) -> NDArray[np.uint8]:
    """Masks with names to one label map; bone lies over soft tissue, markers over all.

    >>> mask = np.ones((1, 1, 1), bool)
    >>> by_name([("Tibia", mask), ("Skin", mask)], Path("a")).item()
    2
    """
    labels = np.zeros(segments[0][1].shape, np.uint8)
    kinds = [(_label(title), mask) for title, mask in segments]
    unknown = [title for title, _ in segments if _label(title) == 0]
    if unknown:
        raise CaseError(
            f"the segment name(s) {', '.join(unknown[:5])} are not understood",
            where=str(path),
            fix="name the segments soft tissue (or skin, muscle), fat, bone (or tibia, fibula ...), marker",
        )
    for value in _ORDER:
        for kind, mask in kinds:
            if kind == value:
                labels[mask] = value
    return labels


def _label(title: str) -> int:
    """
    >>> _label("Fibula left"), _label("subcutaneous fat"), _label("Segment_1")
    (2, 4, 0)
    """
    low = title.lower()
    return next((value for value, words in _WORDS if any(word in low for word in words)), 0)


def _segments(nrrd: Nrrd) -> list[tuple[str, NDArray, int]]:
    """(name, its layer's values, its value) of every segment of a `.seg.nrrd`."""
    found = []
    number = 0
    while f"Segment{number}_Name" in nrrd.pairs:
        key = f"Segment{number}_"
        layer = int(nrrd.pairs.get(key + "Layer", "0"))
        values = nrrd.values[layer] if nrrd.values.ndim == 4 else nrrd.values
        found.append((nrrd.pairs[key + "Name"], values, int(nrrd.pairs.get(key + "LabelValue", number + 1))))
        number += 1
    return found
