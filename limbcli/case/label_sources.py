"""Label maps that a case names, and what their numbers and names are said to be."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from limbcli.case.label_tables import read_label_table
from limbcli.case.reading import CaseReading


@dataclass(frozen=True)
class LabelSource:
    """A label map, and what its numbers and names mean where the file does not say so itself.

    path : a file, or a folder with a file for each segment
    preset : name of the program whose numbers it has; names : tissue by number or name
    titles : names by number (as text) in a file beside it; they count more than its own
    """

    path: Path
    preset: str | None = None
    names: Mapping[str, str] = field(default_factory=dict)
    titles: Mapping[str, str] = field(default_factory=dict)


def read_label_sources(raw: object, reading: CaseReading) -> tuple[LabelSource, ...]:
    """The label maps of a case: one or several, each a name or a table.

    A table has `file`, and where needed `preset`, `names` (a file) and tissues by number or name.
    """
    sources = []
    listed = [] if raw is None else raw if isinstance(raw, list) else [raw]
    for k, each in enumerate(listed):
        table = each if isinstance(each, dict) else {"file": each}
        label = "imaging.labels" if len(listed) == 1 else f"imaging.labels[{k}]"
        path = reading.existing(table.get("file"), label, is_folder=None)
        preset = table.get("preset")
        titles: dict[str, str] = {}
        listing = reading.existing(table.get("names"), f"{label}.names", is_folder=False)
        if listing is not None:
            read, found = read_label_table(listing, f"{label}.names")
            titles = {str(number): name for number, name in read.items()}
            reading.found.extend(found)
        names = {key: word for key, word in table.items() if key not in ("file", "preset", "names")}
        if path is not None and all(isinstance(word, str) for word in names.values()):
            sources.append(LabelSource(path, preset if isinstance(preset, str) else None, names, titles))
    return tuple(sources)
