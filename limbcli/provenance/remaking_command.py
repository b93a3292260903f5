"""The shell command that makes a result again."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from limbcli.errors.pasted_commands import typed
from limbcli.provenance.requested_options import in_words
from limbcli.results import StageResult

_WORDS = {
    "fit-joint": ("fit", "--objective", "joint"),
    "fit-states": ("fit", "--objective", "states"),
    "fit-elements": ("fit", "--compare-element"),
    "mesh-study": ("mesh", "--study"),
}


@dataclass(frozen=True)
class CommandStep:
    """A stage to be run again, for one site or the whole case, with its options."""

    stage: str
    site: str | None = None
    requested: Mapping[str, Any] = field(default_factory=dict, compare=False)
    sites: tuple[str, ...] = field(default=(), compare=False)

    @staticmethod
    def of(result: StageResult) -> CommandStep:
        """The step that repeats a result: a joint fit with the same law(s) and the same sites, a diagnosis of
        all sites of its place."""
        given = result.data.get("asked")
        requested = dict(given) if isinstance(given, Mapping) else {}
        sites = tuple(result.data.get("sites") or ())
        if result.stage == "diagnose" and len(sites) > 1:
            return CommandStep(result.stage, None, requested, sites)
        if result.stage != "fit-joint":
            return CommandStep(result.stage, result.site, requested)
        law = {"law": result.data["law"]} if "law" in result.data else {}
        laws = {"compare_laws": True} if result.data.get("laws") else {}
        return CommandStep(result.stage, None, {**law, **laws, **requested}, sites)

    def command(self, case: Path, out: Path) -> str:
        """
        >>> CommandStep("mesh", "p1", {"fat_layer": "mri"}).command(Path("my limb"), Path("out/S1"))
        "limbcli mesh 'my limb' --site p1 --out out/S1 --fat-mm mri"
        >>> CommandStep("fit-joint", sites=("p1", "p2")).command(Path("limb"), Path("out"))
        'limbcli fit limb --objective joint --site p1 --site p2 --out out'
        """
        command, *words = _WORDS.get(self.stage, (self.stage,))
        sites = [word for each in (self.site, *self.sites) if each for word in ("--site", each)]
        requested = in_words({key: value for key, value in self.requested.items() if value is not None})
        line = f"limbcli {command} {typed(case)} {shlex.join([*words, *sites, '--out'])} {typed(out)}"
        return f"{line} {requested}" if requested else line


def commands(steps: Iterable[CommandStep], case: Path, out: Path) -> str:
    """One command line that runs all steps in order, each once, and stops at the first failure."""
    return " && ".join(each.command(case, out) for each in dict.fromkeys(steps))
