"""Results on a page that are out of date, with one sentence per cause."""

from __future__ import annotations

from pathlib import Path

from limbcli.case import Case
from limbcli.files.atomic import sha256
from limbcli.provenance.remaking_command import commands
from limbcli.provenance.staleness import BrokenLink, Chain
from limbcli.reporting.outcome import Outcomes


def stale_results(case: Case, out: Path, outcomes: Outcomes) -> list[str]:
    """Sentences on what has changed, which results are out of date, and the commands that update them."""
    chain = Chain(case, out)
    causes: dict[str, list[tuple[str, BrokenLink]]] = {}
    for outcome in outcomes.done:
        assert outcome.result is not None
        broken = chain.broken(outcome.result)
        if broken is not None:
            causes.setdefault(broken.what, []).append((outcome.label, broken))
    return [_sentence(case, out, what, found) for what, found in causes.items()] + _altered_pictures(outcomes)


def _altered_pictures(outcomes: Outcomes) -> list[str]:
    """Sentences on pictures of the page that are no longer what their stage drew."""
    return [
        f"{path.name}, drawn by `{result.label}`, was changed since ({path}): the page shows it as it is now"
        for result in (each.result for each in outcomes.done if each.result is not None)
        for name, digest in result.provenance.get("pictures_sha256", {}).items()
        if (path := result.path(name)).is_file() and sha256(path) != digest
    ]


def _sentence(case: Case, out: Path, what: str, found: list[tuple[str, BrokenLink]]) -> str:
    labels = ", ".join(f"“{label}”" for label, _ in found)
    steps = [step for _, broken in found for step in broken.steps]
    return (
        f"{what[0].upper()}{what[1:]} ({found[0][1].where}): what is shown of {labels} is out of date "
        f"with the case; run {commands(steps, case.folder, out)}"
    )
