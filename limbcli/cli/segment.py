"""`limbcli segment CASE`."""

from __future__ import annotations

from limbcli.cli.options import CaseArg, JsonOpt, OutOpt, QuietOpt, VerboseOpt
from limbcli.cli.terminal import emit, terminal


def command(
    case: CaseArg, out: OutOpt = None, json: JsonOpt = False, quiet: QuietOpt = False, verbose: VerboseOpt = 0
) -> None:
    """MRI series to label map, closed surfaces and markers."""
    from limbcli.case import Case
    from limbcli.config import default_out
    from limbcli.stages.segment import segment

    progress = terminal(quiet=quiet, verbose=verbose)
    emit(segment(Case.open(case), out=out or default_out(case), progress=progress), as_json=json)
