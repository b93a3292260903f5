"""`limbcli check CASE`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from limbcli.cli.say import say
from limbcli.cli.terminal import emit_json
from limbcli.options import CASE
from limbcli.progress import Progress


def check_case(case: Annotated[Path, CASE], *, json: bool, progress: Progress) -> None:
    """Check a case folder and list every problem: files, units, ranges, missing entries."""
    from limbcli.errors.pasted_commands import pasted_text
    from limbcli.stages.check import check

    result = check(case, progress=progress)
    if json:
        emit_json(result.to_json())
    else:
        say(f"{case}: looked at {', '.join(result.looked_at)}")
        for line in result.shown:
            say(line)
        for k, problem in enumerate(result.problems, 1):
            say(f"{k}. {problem.severity}: {pasted_text(str(problem), case)}")
        n_errors = sum(each.severity == "error" for each in result.problems)
        to_correct = f"{n_errors} error{'s' if n_errors > 1 else ''} to correct"
        say(to_correct if n_errors else "the case is complete")
    raise typer.Exit(result.exit_code)
