"""Names that a file of its own gives to the numbers of a label map.

Tables of a line for each number: ITK-SNAP's label descriptions, 3D Slicer's colour tables (.ctbl, .csv),
FreeSurfer's, BIDS's `dseg.tsv`. JSON: nnU-Net's `dataset.json`, versions 1 and 2.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from pathlib import Path

from limbcli.errors.problems import Problem


def read_label_table(path: Path, label: str) -> tuple[dict[int, str], list[Problem]]:
    """The name of each number in a file, and a problem if it has none.

    label : the key of case.toml that names the file
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
        found = _in_json(json.loads(text)) if path.suffix.lower() == ".json" else names_by_number(text)
    except (OSError, ValueError, RecursionError) as error:
        found, why = {}, f" ({error})"
    else:
        why = ""
    if found:
        return found, []
    what = f"{label}: {path.name} names no number of a label map{why}"
    fix = (
        'give a table with a line for each number, such as `7 "Tibia"` (ITK-SNAP, 3D Slicer), or the '
        'dataset.json of nnU-Net; or state the numbers in the table itself: 7 = "tibia"'
    )
    return {}, [Problem(what, str(path), fix)]


def names_by_number(text: str) -> dict[int, str]:
    """Names in lines that begin with a number: in quotes, else the second cell, else the words.

    >>> names_by_number('# a comment\\n 2 255 0 0 1 1 1 "Left tibia"\\n3 fibula 0 0 255 0\\n4\\tsoft tissue')
    {2: 'Left tibia', 3: 'fibula', 4: 'soft tissue'}
    >>> names_by_number("index\\tname\\tabbreviation\\n7\\tTibia left\\tSAT")
    {7: 'Tibia left'}
    """
    found = {}
    for line in text.splitlines():
        numbered = re.match(r"\s*(\d+)\W+(.*)", line)
        if numbered is None:
            continue
        quoted = re.search(r'"([^"]+)"', line)
        cells = re.split(r"[\t,]", line.strip())
        if quoted:
            words = quoted[1]
        elif len(cells) > 1 and re.search(r"[^\W\d]", cells[1]):
            words = cells[1].strip()
        else:
            words = " ".join(re.findall(r"[^\W\d][\w-]*", numbered[2]))
        if words:
            found[int(numbered[1])] = words
    return found


def _in_json(content: object) -> dict[int, str]:
    """
    >>> _in_json({"labels": {"background": 0, "tibia": 2}}), _in_json({"labels": {"2": "tibia"}})
    ({0: 'background', 2: 'tibia'}, {2: 'tibia'})
    """
    inner = content.get("labels", content) if isinstance(content, Mapping) else {}
    found = {}
    for key, value in inner.items() if isinstance(inner, Mapping) else ():
        number, name = (key, value) if isinstance(value, str) else (value, key)
        if re.fullmatch(r"\d+", str(number)):
            found[int(number)] = str(name)
    return found
