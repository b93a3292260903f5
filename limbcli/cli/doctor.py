"""`limbcli doctor`."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Annotated

import typer

from limbcli.cli.say import say
from limbcli.cli.terminal import emit_json
from limbcli.options import FEBIO
from limbcli.progress import Progress

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
