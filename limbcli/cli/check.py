"""`limbcli check CASE` and `limbcli doctor`."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Annotated

import typer

from limbcli.cli.output import say
from limbcli.cli.terminal import emit_json
from limbcli.options import CASE, FEBIO
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


_MARKS = {"good": "  ", "note": "- ", "missing": "! "}


def check_machine(*, febio: Annotated[Path | None, FEBIO] = None, json: bool, progress: Progress) -> None:
    """Check this machine for limbcli's requirements: versions, libraries, solvers with a self test, memory.

    Exit code 4 if a requirement is missing; every such line gives the fix.
    """
    from limbcli.stages.doctor import doctor

    result = doctor(febio=febio, progress=progress)
    if json:
        emit_json(result.to_json())
    else:
        for topic, findings in itertools.groupby(result.findings, key=lambda each: each.topic):
            say(topic)
            for each in findings:
                say(f"{_MARKS[each.state]}{each.name}: {each.found}")
                if each.fix:
                    say(f"    fix: {each.fix}")
        n = len(result.missing)
        say("all requirements are met" if not n else f"{n} missing or broken, marked with !")
    raise typer.Exit(result.exit_code)
