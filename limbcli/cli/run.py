"""`limbcli run CASE` or `limbcli run FILE.feb`."""

from __future__ import annotations

import inspect
from pathlib import Path
from typing import Annotated, Any

from limbcli.api.simulation import run, run_feb
from limbcli.errors import CaseError
from limbcli.options import Option
from limbcli.results import StageResult


def run_case_or_file(
    case: Annotated[
        Path | None, Option("Case folder, or a FEBio model of your own.", metavar="CASE|FILE.feb", kind=Path)
    ] = None,
    *,
    feb: Annotated[Path | None, Option("A FEBio model instead of a case.", metavar="FILE", kind=Path)] = None,
    sites: list[str] | None,
    **options: Any,
) -> StageResult | list[StageResult]:
    """Simulate the indentation with FEBio, or with the bundled reference solver."""
    file = feb or (case if case is not None and is_model_file(case) else None)
    if file is not None and (case is None or file == case):
        if sites:
            raise CaseError(
                "a model file has no sites", where="--site", fix="omit --site, or give a case folder"
            )
        return inspect.unwrap(run_feb)(file, **options)
    if case is None or feb is not None:
        raise CaseError(
            "give either a case folder or one model file",
            where="limbcli run",
            fix="limbcli run CASE, or limbcli run FILE.feb",
        )
    return list(inspect.unwrap(run)(case, sites=sites, **options))


def is_model_file(path: Path) -> bool:
    """
    >>> is_model_file(Path("model.feb.gz")), is_model_file(Path("cases/phantom"))
    (True, False)
    """
    return path.name.endswith((".feb", ".feb.gz"))
