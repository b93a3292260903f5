"""Check that slices are of one patient and frame of reference.

Slices of another patient may fit in position and size.
"""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

from pydicom.dataset import Dataset

from limbcli.errors import CaseError
from limbcli.errors.problems import shortened

_OWN = 0.4  # with more distinct values than this fraction of the images, a tag is uninformative
_WORD = 3  # letters: shorter parts of a patient's name or id are not searched for in a file name
_TAGS = (
    ("PatientID", "Patient ID (0010,0020)", "patient"),
    ("FrameOfReferenceUID", "Frame of Reference UID (0020,0052)", "frame of reference"),
)


def public_name(path: Path, dataset: Dataset, number: int) -> str:
    """The file name to show in messages, unless it identifies the patient."""
    private = f"{dataset.get('PatientName', '')} {dataset.get('PatientID', '')}".lower()
    words = [each for each in re.split(r"[^\w]+|_", private) if len(each) >= _WORD]
    reported = any(each in path.name.lower() for each in words)
    return f"file {number} in order of name" if reported else path.name


def one_body(datasets: list[tuple[str, Dataset]], folder: Path) -> tuple[str, ...]:
    """Notes on uninformative tags.

    datasets : (name to show in messages, header) of every image; no value of a tag is ever shown

    Raises CaseError if some images are of another patient, or another frame of reference, than the majority.
    """
    notes = []
    for keyword, tag, noun in _TAGS:
        values = [str(dataset.get(keyword, "") or "").strip() for _, dataset in datasets]
        counts = Counter(each for each in values if each)
        if len(counts) < 2:
            if counts and "" in values:
                notes.append(f"{values.count('')} of {len(values)} images have no {tag}")
            continue
        if keyword != "PatientID" and len(counts) > _OWN * len(datasets):
            notes.append(f"every image has its own {tag}; it was ignored")
            continue
        usual = counts.most_common(1)[0][0]
        odd = [name for (name, _), value in zip(datasets, values, strict=True) if value not in ("", usual)]
        raise CaseError(
            f"{len(odd)} of {len(datasets)} images are of another {noun}, by {tag}: {shortened(odd)}",
            where=str(folder),
            fix="remove them, and copy the patient's own series again; if it is the same patient and scan, "
            "give all images the same tag",
            n_odd=len(odd),
            tag=keyword,
        )
    return tuple(notes)
