"""`limbcli doctor`."""

from __future__ import annotations

import itertools

import typer

from limbcli.cli.options import FebioOpt, JsonOpt, QuietOpt, VerboseOpt
from limbcli.cli.say import say
from limbcli.cli.terminal import emit_json, terminal

_MARKS = {"good": "  ", "note": "- ", "missing": "! "}


def command(
    febio: FebioOpt = None, json: JsonOpt = False, quiet: QuietOpt = False, verbose: VerboseOpt = 0
) -> None:
    """Check this machine for limbcli's requirements: versions, libraries, solvers with a self test, memory.

    Exit code 4 if a requirement is missing; every such line gives the fix.
    """
    from limbcli.stages.doctor import doctor

    result = doctor(febio=febio, progress=terminal(quiet=quiet, verbose=verbose))
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
