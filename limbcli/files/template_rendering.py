"""Render templates; any fault in one is reported as an error that names its file and line."""

from __future__ import annotations

import difflib
import traceback
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import jinja2
from jinja2.bccache import Bucket

from limbcli.errors import CaseError

# Errors that an expression in a template can raise besides Jinja's own; a file that is not UTF-8 raises a
# ValueError.
_OF_EXPRESSIONS = (ArithmeticError, AttributeError, LookupError, RecursionError, TypeError, ValueError)

_TOLD_IN = ".md"  # suffix of the README in a template folder, which is not a template


class TemplateFolders(jinja2.FileSystemLoader):
    """Searches several folders in order. requested : names of the templates loaded, in order"""

    def __init__(self, folders: Sequence[Path]):
        super().__init__(folders)
        self.requested: list[str] = []

    def get_source(
        self, environment: jinja2.Environment, template: str
    ) -> tuple[str, str, Callable[[], bool]]:
        self.requested.append(template)
        return super().get_source(environment, template)


class _Compiled(jinja2.BytecodeCache):
    """Templates compiled earlier in this process; those whose text has changed since are compiled again."""

    def __init__(self) -> None:
        self._by_key: dict[str, bytes] = {}

    def load_bytecode(self, bucket: Bucket) -> None:
        if bucket.key in self._by_key:
            bucket.bytecode_from_string(self._by_key[bucket.key])

    def dump_bytecode(self, bucket: Bucket) -> None:
        self._by_key[bucket.key] = bucket.bytecode_to_string()


# of environments with the same options for the same file: compiling takes ten times as long as rendering
COMPILED = _Compiled()


def plain_text_templates(folder: Path) -> jinja2.Environment:
    """limbcli's own templates of plain text."""
    return jinja2.Environment(
        loader=jinja2.FileSystemLoader(folder), undefined=jinja2.StrictUndefined, trim_blocks=True,
        keep_trailing_newline=True,
    )  # fmt: skip


def filled(environment: jinja2.Environment, template: str, facts: Mapping[str, Any], *, ours: str) -> str:
    """Render a template. ours : location of limbcli's own templates, for comparison in the message

    Raises CaseError if it cannot be read, or fails.
    """
    try:
        return environment.get_template(template).render(facts)
    except (jinja2.TemplateError, *_OF_EXPRESSIONS) as error:
        raise CaseError(
            f"a template is invalid: {error or type(error).__name__}",
            where=_place(error, environment, template),
            fix=f"compare it with limbcli's own {ours}, or omit --templates",
        ) from error


def refuse_unused(environment: jinja2.Environment, folder: Path, ours: Path, *, below: str = "") -> None:
    """Refuse a user's template that replaces none of ours and is included by no other.

    It would be ignored silently.

    environment : the environment that rendered the templates
    folder, ours : the user's and limbcli's own folder of one kind of template
    below : prefix of a template's name when it is loaded

    Raises CaseError for the first such file.
    """
    assert isinstance(environment.loader, TemplateFolders)
    known = {path.name for path in ours.iterdir() if path.suffix != _TOLD_IN}
    endings = {Path(name).suffix for name in known}
    for path in sorted(each for each in folder.glob("*.*") if each.suffix in endings):
        if path.name not in known and f"{below}{path.name}" not in environment.loader.requested:
            near = difflib.get_close_matches(path.name, sorted(known), n=1)
            raise CaseError(
                f"the template {path.name} is not used",
                where=str(path),
                fix=f"did you mean {near[0]}?"
                if near
                else f"include it, or rename it to one of {', '.join(sorted(known))}",
            )


def _place(error: Exception, environment: jinja2.Environment, template: str) -> str:
    """File and line, as far as known, of the innermost frame that lies in a template."""
    if isinstance(error, jinja2.TemplateSyntaxError):
        return f"{error.filename or error.name or template}, line {error.lineno}"
    if isinstance(error, UnicodeDecodeError):
        loader = environment.loader
        return loader.requested[-1] if isinstance(loader, TemplateFolders) and loader.requested else template
    frames = [
        each for each in traceback.extract_tb(error.__traceback__) if Path(each.filename).suffix == ".j2"
    ]
    return f"{frames[-1].filename}, line {frames[-1].lineno}" if frames else template
