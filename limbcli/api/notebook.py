"""How results and progress look in a notebook."""

from __future__ import annotations

import base64
import html
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from limbcli.numbers.significant_digits import short

_MOST_ROWS = 20
_LARGEST_PICTURE = 2_000_000  # bytes
_PICTURES = ("picture", "contact_sheet")  # the first that a result has is shown


def findings(lines: Sequence[str], warnings: Sequence[str]) -> str:
    """Findings as paragraphs, and warnings below them."""
    told = "".join(f"<div>{html.escape(each)}</div>" for each in lines)
    warned = "".join(f"<div><b>warning:</b> {html.escape(each)}</div>" for each in warnings)
    return told + warned


def html_table(rows: Sequence[Mapping[str, Any]]) -> str:
    """The first rows as a table; nothing if there are none.

    >>> html_table([{"c_kpa": 8.5091325}])
    '<table><tr><th>c_kpa</th></tr><tr><td>8.51</td></tr></table>'
    """
    if not rows:
        return ""
    names = list(dict.fromkeys(name for row in rows for name in row))
    head = "".join(f"<th>{html.escape(name)}</th>" for name in names)
    body = "".join(
        f"<tr>{''.join(f'<td>{_cell(row.get(name))}</td>' for name in names)}</tr>"
        for row in rows[:_MOST_ROWS]
    )
    rest = len(rows) - _MOST_ROWS
    more = f"<div>... and {rest} more rows: see table() or to_frame()</div>" if rest > 0 else ""
    return f"<table><tr>{head}</tr>{body}</table>{more}"


def _cell(value: object) -> str:
    if isinstance(value, float):
        return short(value)
    return "" if value is None else html.escape(str(value))


def html_picture(files: Mapping[str, Path]) -> str:
    """A result's own picture, embedded; nothing if it has none."""
    for name in _PICTURES:
        path = files.get(name)
        if path is None or path.suffix != ".png" or not path.is_file():
            continue
        if path.stat().st_size <= _LARGEST_PICTURE:
            content = base64.b64encode(path.read_bytes()).decode("ascii")
            return f'<img style="max-width: 100%" alt="{name}" src="data:image/png;base64,{content}">'
    return ""


class ShownProgress:
    """A listener for `progress=`: shows what is being done, in one place of a notebook that is kept current.

    Without a notebook it prints each stage and note as a line.

    >>> progress = ShownProgress()
    >>> progress("stage", {"name": "mesh", "site": "p1"})
    mesh p1
    >>> progress("task", {"name": "surfaces", "done": 1, "total": 4})
    >>> progress._repr_html_()
    '<div>mesh p1: surfaces <progress max="4" value="1"></progress> 1 of 4</div>'
    """

    def __init__(self) -> None:
        self._stage = ""
        self._now = ""
        self._handle: Any = None
        self._in_notebook = _in_notebook()

    def __call__(self, kind: str, facts: Mapping[str, Any]) -> None:
        told = self._told(kind, facts)
        if told is None:
            return
        if self._in_notebook:
            self._show()
        elif kind in ("stage", "note"):
            print(told)  # noqa: T201

    def _told(self, kind: str, facts: Mapping[str, Any]) -> str | None:
        """The event in words, None if it is not shown."""
        if kind == "stage":
            self._stage, self._now = (
                " ".join(str(facts[key]) for key in ("name", "site") if facts.get(key)),
                "",
            )
            return self._stage
        if kind == "task":
            done, total = facts.get("done", 0), facts.get("total", 1)
            bar = f'<progress max="{total}" value="{done}"></progress>'
            self._now = f"{html.escape(str(facts.get('name')))} {bar} {done} of {total}"
        elif kind == "solve":
            self._now = f"simulation {facts.get('number')} of at most {facts.get('at_most')}"
        elif kind == "fit":
            self._now = f"iteration {facts.get('iteration')}"
        elif kind == "compile":
            self._now = f"compiling {html.escape(str(facts.get('what')))}"
        elif kind == "note":
            self._now = html.escape(str(facts.get("text")))
            return str(facts.get("text"))
        else:
            return None
        return self._now

    def _show(self) -> None:
        from IPython.display import display

        if self._handle is None:
            self._handle = display(self, display_id=True)
        else:
            self._handle.update(self)

    def _repr_html_(self) -> str:
        now = f": {self._now}" if self._now else ""
        return f"<div>{html.escape(self._stage)}{now}</div>"


def _in_notebook() -> bool:
    """Whether IPython runs this in a kernel, whose displays can be updated."""
    ipython = sys.modules.get("IPython")
    shell = ipython.get_ipython() if ipython is not None else None
    return shell is not None and hasattr(shell, "kernel")
