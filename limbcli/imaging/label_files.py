"""Read label maps in the formats of segmentation programs and convert them to our labels.

NIfTI and plain NRRD must already contain our numbers (1 soft tissue, 2 bone, 3 marker, 4 fat); in `.seg.nrrd`
and DICOM SEG the names of the segments decide.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from fnmatch import fnmatchcase
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from limbcli.errors import CaseError
from limbcli.imaging.dicom_seg import read_dicom_seg
from limbcli.imaging.labels import checked_labels, read_labels
from limbcli.imaging.nrrd import Nrrd, read_nrrd
from limbcli.imaging.segmentation import BONE, FAT, MARKER, SOFT_TISSUE
from limbcli.imaging.volume import Volume

# Words that identify the kinds of segment: whole words, or prefixes where marked with a star. Names of bones
# are whole words: "tibialis" is not "tibia".
_MARKER = ("marker*", "capsule*", "fiducial*", "pinpoint*")
_IN_FLESH = (  # takes precedence over bones, after which many muscles are named
    "musc*", "muskel*", "tibialis", "fibularis", "peroneus", "gastrocnemi*", "soleus", "plantaris",
    "popliteus", "flexor*", "extensor*", "femoris", "vastus", "quadriceps", "biceps", "triceps", "hamstring*",
    "sartorius", "gracilis", "adductor*", "tendon*", "ligament*", "nerve*", "arter*", "vein*", "vessel*",
)  # fmt: skip
_BONE = (
    "bone*", "tibia", "tibiae", "tibias", "fibula", "fibulae", "fibulas", "femur", "femurs", "femora",
    "patella", "patellae", "patellas", "knochen*", "cortex", "marrow",
)  # fmt: skip
_FAT = ("fat", "fatty", "adipose", "subcut*")
_SOFT = ("soft*", "skin*", "flesh*")
_ANY_TISSUE = ("tissue*", "limb*", "leg*", "stump*")  # soft tissue, if no other kind is named
# what follows such a word is not in the segment
_WITHOUT = ("without", "no", "not", "non", "excluding", "except", "minus", "ohne")
_WORD = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])")  # "Tibia_left", "tibiaLeft" and "TIBIA2" hold "tibia"
_ORDER = (SOFT_TISSUE, FAT, BONE, MARKER)  # drawing order: a later kind overwrites an earlier one


def read_label_file(path: Path) -> Volume:
    """Read a label map from NIfTI, NRRD, `.seg.nrrd` or DICOM SEG, in patient LPS.

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
    """Combine named masks into one label map; bone overwrites soft tissue, markers overwrite everything.

    >>> mask = np.ones((1, 1, 1), bool)
    >>> by_name([("Tibia", mask), ("Skin", mask)], Path("a")).item()
    2
    """
    labels = np.zeros(segments[0][1].shape, np.uint8)
    kinds = [(_label(title), mask) for title, mask in segments]
    unknown = [title for (kind, _), (title, _) in zip(kinds, segments, strict=True) if kind == 0]
    if unknown:
        raise CaseError(
            f"the segment name(s) {', '.join(unknown[:5])} are not recognised, or refer to several "
            "kinds of tissue",
            where=str(path),
            fix="call the segments soft tissue (or skin, muscle), fat, bone (or tibia, fibula ...), marker",
        )
    for value in _ORDER:
        for kind, mask in kinds:
            if kind == value:
                labels[mask] = value
    return labels


def _label(title: str) -> int:
    """The label that a segment's name stands for; 0 if none or several.

    >>> _label("Fibula left"), _label("subcutaneous fat"), _label("Tibialis anterior")
    (2, 4, 1)
    >>> _label("soft tissue without bone"), _label("Segment_1"), _label("bone and fat")
    (1, 0, 0)
    """
    words = [each.lower() for each in _WORD.findall(title)]
    named = words[: next((k for k, word in enumerate(words) if word in _WITHOUT), None)]
    if _names_any(named, _MARKER):
        return MARKER
    is_flesh = _names_any(named, _IN_FLESH)
    kinds = {SOFT_TISSUE} if is_flesh or _names_any(named, _SOFT) else set()
    if _names_any(named, _BONE) and not is_flesh:
        kinds.add(BONE)
    if _names_any(named, _FAT):
        kinds.add(FAT)
    if not kinds and _names_any(named, _ANY_TISSUE):
        return SOFT_TISSUE
    return kinds.pop() if len(kinds) == 1 else 0


def _names_any(words: Sequence[str], of_kind: Sequence[str]) -> bool:
    return any(fnmatchcase(word, each) for word in words for each in of_kind)


def _segments(nrrd: Nrrd) -> list[tuple[str, NDArray, int]]:
    """(name, values of its layer, its value) of every segment of a `.seg.nrrd`."""
    found = []
    number = 0
    while f"Segment{number}_Name" in nrrd.pairs:
        key = f"Segment{number}_"
        layer = int(nrrd.pairs.get(key + "Layer", "0"))
        values = nrrd.values[layer] if nrrd.values.ndim == 4 else nrrd.values
        found.append((nrrd.pairs[key + "Name"], values, int(nrrd.pairs.get(key + "LabelValue", number + 1))))
        number += 1
    return found
