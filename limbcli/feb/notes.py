"""What reading a model file finds besides the model: all that is refused, and what is left out."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from limbcli.errors import CaseError

_MOST_LINES = 40  # number of refusals that are written out
_FOLLOWS = "follows"  # fact of an error that may only follow from another one


@dataclass
class ReadingNotes:
    """refused : errors in the order found; ignored : what cannot change a result, in a few words each."""

    refused: list[CaseError] = field(default_factory=list)
    ignored: list[str] = field(default_factory=list)

    @contextmanager
    def goes_on(self) -> Iterator[None]:
        """Collect a CaseError, so that the rest of the file is judged too."""
        try:
            yield
        except CaseError as error:
            self.refused.append(error)

    def ignore(self, what: str) -> None:
        if what not in self.ignored:
            self.ignored.append(what)

    def raise_refused(self, file: Path) -> None:
        """Raise all that was refused as one CaseError (its fact `problems` lists them), if there is any."""
        own = [each for each in self.refused if not each.facts.get(_FOLLOWS)]
        found: dict[str, list[CaseError]] = {}
        for each in sorted(own or self.refused, key=_line):
            found.setdefault(each.what, []).append(each)
        if not found:
            return
        if len(found) == 1:
            raise next(iter(found.values()))[0]
        lines = [_told(same) for same in found.values()]
        more = [f"... and {len(lines) - _MOST_LINES} more"] if len(lines) > _MOST_LINES else []
        first = next(iter(found.values()))[0]
        listed = "\n".join(f"  {line}" for line in [*lines[:_MOST_LINES], *more])
        raise CaseError(
            f"{len(lines)} things in this file are not supported:\n{listed}",
            where=f"{file}, from line {_line(first)}",
            fix="change or remove them, or run the file with FEBio (--solver febio)",
            **{**first.facts, "problems": lines},
        )


def _line(error: CaseError) -> int:
    line = error.facts.get("line", 0)
    return line if isinstance(line, int) else 0


def _told(same: list[CaseError]) -> str:
    others = f" (and {len(same) - 1} more times)" if len(same) > 1 else ""
    return f"line {_line(same[0])}: {same[0].what}{others}; {same[0].fix}"
