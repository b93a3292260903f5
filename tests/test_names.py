"""One meaning, one name: no two classes of the package share theirs, but for those of one file alone."""

from __future__ import annotations

import re
from collections import defaultdict
from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[1] / "limbcli"


def test_no_two_classes_have_one_name() -> None:
    places = defaultdict(list)
    for path in sorted(PACKAGE.rglob("*.py")):
        for name in re.findall(
            r"^ *class ([A-Za-z]\w*) *[:(\[]", path.read_text(encoding="utf-8"), re.MULTILINE
        ):
            places[name].append(path.relative_to(PACKAGE).as_posix())
    assert len(places) > 300, "the package is read"
    assert {name: found for name, found in places.items() if len(found) > 1} == {}
