"""The page of a cohort, and its pictures in a folder next to it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from limbcli.cohorts.sections import cohort_reportlets
from limbcli.reporting.page import embed, render, save_pictures

PICTURES = "pictures"
TEMPLATE = "cohort.html.j2"
_NAMES = frozenset({"distributions", "misfits", "one-tissue", "left-out"})
_ENDINGS = (".png", ".svg", "-data.csv")


def cohort_page(data: Mapping[str, Any], out: Path, name: str, *, templates: Path | None = None) -> Path:
    """Write `<out>/<name>` and `<out>/pictures/`, in a new folder; the page needs no other file."""
    reportlets = cohort_reportlets(data)
    (out / PICTURES).mkdir()
    shown = embed(reportlets, save_pictures(reportlets, out / PICTURES))
    facts = {"data": data, "reportlets": reportlets, "shown": shown, "own": data["provenance"]}
    html = render(TEMPLATE, facts, templates=templates)
    (out / name).write_text(html, encoding="utf-8")
    return out / name


def is_ours(path: Path) -> bool:
    """Whether a file in the folder of pictures has the name of a cohort's picture.

    >>> is_ours(Path("pictures/left-out-data.csv")), is_ours(Path("pictures/holiday.png"))
    (True, False)
    """
    return any(path.name.removesuffix(each) in _NAMES for each in _ENDINGS if path.name.endswith(each))
