"""Pages that the program writes of itself: commands, keys of case.toml, effects, laws; benchmarks."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

import rooms
import typer
from typer.cli import get_docs_for_click

from limbcli.case import schema as schema
from limbcli.case.imaging import SHAPE
from limbcli.cli.app import COMMANDS, app
from limbcli.effects import EFFECTS
from limbcli.materials.laws import LAWS, WRAPPERS

FIGURES = Path(__file__).resolve().parents[1] / "tests" / "benchmarks" / "figures"
TABLES = {
    "[subject]": schema.SUBJECT,
    "[imaging]": schema.IMAGING,
    "[imaging] shape": SHAPE,
    "[probe]": schema.PROBE,
    "[model]": schema.MODEL,
    "[socket]": schema.SOCKET,
    "[socket.knee]": schema.KNEE,
    "[socket.liner]": schema.LINER,
    "[[site]]": schema.SITE,
    "[[site.pennation]]": schema.PENNATION,
    "[[site.state]]": schema.STATE,
    "[site.noise]": schema.NOISE,
    "[site.layers.skin], [site.layers.fat]": schema.LAYER,
    "[site.load_cell]": schema.LOAD_CELL,
    "[site.b_mode]": schema.B_MODE,
    "[site.swe_images]": schema.SWE_IMAGES,
    "[files]": schema.FILES,
}


def write_all(folder: Path) -> None:
    """Every page, into `folder`; a page that is as it was keeps its time stamp."""
    folder.mkdir(exist_ok=True)
    pages = {f"command-{name}": command_page(name) for name in COMMANDS}
    pages |= {"case-keys": case_keys(), "effects": effects(), "laws": laws()}
    pages |= {"benchmarks": benchmarks(), "rooms": rooms.table()}
    pages |= {
        f"figures-{path.stem}": _beside(path.read_text(encoding="utf-8")) for path in FIGURES.glob("*.md")
    }
    for name, text in pages.items():
        path = folder / f"{name}.md"
        if not path.is_file() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")
    rooms.draw(folder / "rooms.svg")
    for path in folder.glob("*.md"):
        if path.stem not in pages:
            path.unlink()


def benchmarks() -> str:
    """How they are repeated and what is asked, with links to the pages of figures as they are called here."""
    text = (FIGURES.parent / "README.md").read_text(encoding="utf-8")
    return text.partition("## Pages")[0].replace("](figures/", "](generated/figures-")


def _beside(text: str) -> str:
    """A page of figures whose neighbours are called as the generated ones are."""
    return re.sub(r"\]\(([a-z-]+\.md)", r"](figures-\1", text)


def command_page(name: str) -> str:
    """A command as its own help tells it."""
    group = typer.main.get_command(app)
    command = group.commands[name]  # type: ignore[attr-defined]
    context = typer.Context(command, info_name=name)
    text = get_docs_for_click(obj=command, ctx=context, name=f"limbcli {name}", title=f"limbcli {name}")
    return "\n".join(map(_plain, text.rstrip().splitlines())) + "\n"


def _plain(line: str) -> str:
    """A `<` outside of backquotes would open an HTML tag.

    >>> _plain("* `--out DIR`: default: out/<name>, see `<b>`")
    '- `--out DIR`: default: out/\\\\<name>, see `<b>`'
    """
    parts = line.split("`")
    parts[::2] = [each.replace("<", r"\<") for each in parts[::2]]
    return "`".join(parts).replace("* ", "- ", 1) if line.startswith("* ") else "`".join(parts)


def case_keys() -> str:
    """Every key that may stand in case.toml."""
    parts = []
    for title, keys in TABLES.items():
        rows = (
            (f"`{name}`", each.kind, "required" if each.required else _default(each.default))
            for name, each in keys.items()
        )
        parts.append(f"### `{title}`\n\n{_table(('key', 'value', 'default'), rows)}\n")
    return "\n".join(parts)


def _default(value: object) -> str:
    if value is None or value == {}:
        return "none"
    return f"`{str(value).lower() if isinstance(value, bool) else value}`"


def effects() -> str:
    """Every effect that a diagnosis may name."""
    rows = (
        (
            f"`{each.name}`", each.kind, each.sentence,
            ", ".join(f"`{p.name}` {p.typical:g} ({p.low:g} to {p.high:g})" for p in each.parameters),
            ", ".join(each.needs), each.source,
        )
        for each in EFFECTS
    )  # fmt: skip
    return (
        _table(
            ("effect", "kind", "what it says", "parameters: typical size (bounds)", "needs", "source"), rows
        )
        + "\n"
    )


def laws() -> str:
    """Every law, with its parameters."""
    rows = [(f"`{name}`", ", ".join(f"`{p}`" for p in law.parameters)) for name, law in LAWS.items()]
    rows += [(f"`{name}`", "made of other laws") for name in WRAPPERS]
    return _table(("law", "parameters"), rows) + "\n"


def _table(heads: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    heads = list(heads)
    lines = [heads, ["-"] * len(heads), *([_cell(each) for each in row] for row in rows)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("\n", " ") or " "
