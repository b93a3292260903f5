"""Make commands in error messages ready to paste: the case's path for CASE, and no removed paths."""

from __future__ import annotations

import re
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TypeVar

from limbcli.errors import LimbError
from limbcli.errors.file_system import PARTIAL, SCRATCH, in_utf8

AnyError = TypeVar("AnyError", bound=LimbError)
WITHOUT_OUT = ("check", "new", "doctor", "phantom")  # commands that have no --out
_COMMAND = re.compile(r"limbcli ([a-z-]+) CASE\b(?!\.)(?P<rest>[^`;,\n]*)")
_PASSING = re.compile(
    rf"[^\s:,;'\"()`]*(?:{re.escape(PARTIAL)}|{re.escape(SCRATCH)})[^\s:,;'\"()`/]*(/[^\s:,;'\"()`]*)?"
)


def typed(path: Path | str) -> str:
    """A path as a shell word; one that begins with a dash cannot be mistaken for an option.

    >>> typed(Path("my case")), typed("-left")
    ("'my case'", './-left')
    """
    text = str(path)
    return shlex.quote(f"./{text}" if text.startswith("-") else text)


def command_line(words: Sequence[str]) -> str:
    """The command that started this process, as it can be typed again.

    >>> command_line(["/venv/bin/limbcli", "fit", "my case"])
    "limbcli fit 'my case'"
    >>> command_line(["/venv/lib/limbcli/__main__.py", "doctor"])
    'python -m limbcli doctor'
    """
    program = Path(words[0])
    is_module = program.name == "__main__.py"
    first = f"python -m {shlex.quote(program.parent.name)}" if is_module else shlex.quote(program.name)
    return in_utf8(" ".join([first, *map(shlex.quote, words[1:])]))


def pasted(error: AnyError, case: Path | None, out: Path | None = None) -> AnyError:
    """The same error with the case's path in every command, and without paths of removed folders.

    out : the output folder, if one was given; commands that use it get `--out`

    >>> error = LimbError("a", where="b", fix="run `limbcli mesh CASE --site p1` first")
    >>> pasted(error, Path("my case"), Path("results")).fix
    "run `limbcli mesh 'my case' --site p1 --out results` first"
    """
    facts = dict(error.facts)
    if isinstance(facts.get("problems"), list):
        facts["problems"] = [_problem(each, case, out) for each in facts["problems"]]  # type: ignore[attr-defined]
    texts = (pasted_text(each, case, out) for each in (error.what, error.where, error.fix))
    what, where, fix = texts
    return type(error)(what, where=where, fix=fix, **facts)


def pasted_text(text: str, case: Path | None, out: Path | None = None) -> str:
    """
    >>> pasted_text("then `limbcli check CASE` to be sure", Path("S1"), Path("results"))
    'then `limbcli check S1` to be sure'
    >>> pasted_text("/tmp/limbcli-scratch-xy/case/case.toml, line 3", None)
    'case/case.toml (a temporary file), line 3'
    """
    text = _PASSING.sub(_kept, text)
    return text if case is None else _COMMAND.sub(lambda found: _command(found, case, out), text)


def _problem(content: object, case: Path | None, out: Path | None) -> object:
    if not isinstance(content, Mapping):
        return content
    return {k: pasted_text(v, case, out) if isinstance(v, str) else v for k, v in content.items()}


def _command(found: re.Match[str], case: Path, out: Path | None) -> str:
    name, rest = found[1], found["rest"].rstrip()
    tail = found["rest"][len(rest) :]
    words = f"limbcli {name} {typed(case)}{rest}"
    is_whole = not rest or all(each.startswith("-") for each in rest.split()[::2])
    if out is not None and name not in WITHOUT_OUT and "--out" not in rest and is_whole:
        words += f" --out {typed(out)}"
    return words + tail


def _kept(found: re.Match[str]) -> str:
    """Replace a path in a temporary folder by its name within that folder."""
    if Path(found[0]).exists():
        return found[0]
    inside = (found[1] or "").strip("/")
    return f"{inside} (a temporary file)" if inside else "a temporary folder"
