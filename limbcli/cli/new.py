"""`limbcli new DIR`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from limbcli.options import Option
from limbcli.results import StageResult


def new_case(
    folder: Annotated[Path, Option("Case folder to create; absent or empty.", metavar="DIR", kind=Path)],
    *,
    sites: Annotated[
        list[str] | None,
        Option(
            "Name of a measured site (may be repeated); default: p1.",
            flag="--site",
            short="-s",
            metavar="NAME",
            kind=list[str],
        ),
    ] = None,
) -> StageResult:
    """Create a case folder to fill in: commented case.toml, levels.csv, and a README that says where data go.

    Existing files are never changed: a folder that is not empty is rejected.
    """
    from limbcli.stages.new import new

    return new(folder, sites=tuple(sites or ["p1"]))
