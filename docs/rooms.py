"""The structure of the program, from its imports: rooms (packages), their floors, a table and a picture."""

from __future__ import annotations

import ast
import functools
from collections.abc import Mapping
from graphlib import TopologicalSorter
from pathlib import Path

from matplotlib import rc_context
from matplotlib.figure import Figure

PACKAGE = Path(__file__).resolve().parents[1] / "limbcli"
ENTRANCES = ("__init__", "__main__")  # import names for those who call, nothing imports them
EVERYWHERE = ("files", "numbers", "errors")  # like the loose modules: imported by most, drawn without arrows
_HEIGHT = 0.46  # of a room, in units of the picture


def rooms() -> dict[str, list[Path]]:
    """Every package below limbcli with its modules; a loose module is a room of its own."""
    found: dict[str, list[Path]] = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        parts = path.relative_to(PACKAGE).parts
        if parts[0].removesuffix(".py") not in ENTRANCES:
            found.setdefault(parts[0].removesuffix(".py"), []).append(path)
    return found


def arrows() -> dict[str, set[str]]:
    """The rooms that each room imports, also inside functions."""
    known = rooms()
    found: dict[str, set[str]] = {}
    for room, paths in known.items():
        names = {name for path in paths for name in _imported(path)}
        found[room] = {name for name in names if name in known} - {room}
    return found


@functools.cache
def _imported(path: Path) -> set[str]:
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "limbcli":
            below = (node.module or "").split(".")[1:2]
            found |= set(below or [each.name for each in node.names])
        elif isinstance(node, ast.Import):
            found |= {each.name.split(".")[1] for each in node.names if each.name.startswith("limbcli.")}
    return found


def floors(below: Mapping[str, set[str]]) -> dict[str, int]:
    """Floor of each room: one above the highest that it imports.

    Raises
    ------
    graphlib.CycleError
        If rooms import each other in a circle.

    >>> floors({"cli": {"api"}, "api": {"model"}, "model": set()})
    {'model': 0, 'api': 1, 'cli': 2}
    """
    found: dict[str, int] = {}
    for room in TopologicalSorter(below).static_order():
        found[room] = 1 + max((found[each] for each in below[room]), default=-1)
    return found


def needed(below: Mapping[str, set[str]]) -> dict[str, set[str]]:
    """The arrows without those that others imply.

    >>> needed({"cli": {"api", "model"}, "api": {"model"}, "model": set()})
    {'cli': {'api'}, 'api': {'model'}, 'model': set()}
    """
    reached: dict[str, set[str]] = {}
    for room in TopologicalSorter(below).static_order():
        reached[room] = below[room].union(*(reached[each] for each in below[room]))
    return {
        room: {each for each in others if not any(each in reached[other] for other in others - {each})}
        for room, others in below.items()
    }


def picture() -> Figure:
    """Rooms on their floors; an arrow leads to what a room imports, unless others imply it.

    What most rooms import stands below without arrows.
    """
    known = rooms()
    base = [room for room in known if room in EVERYWHERE or known[room] == [PACKAGE / f"{room}.py"]]
    below = {room: others - set(base) for room, others in arrows().items() if room not in base}
    floor, spots = floors(below), {}
    for level in range(max(floor.values()) + 1):
        here = [room for room, each in floor.items() if each == level]
        # above the middle of what it imports, so that few arrows cross
        here.sort(key=lambda room: sum(spots[each][0] for each in below[room]) / max(len(below[room]), 1))
        for k, room in enumerate(here):
            spots[room] = (1.7 * (k - (len(here) - 1) / 2), float(level))
    wide = max(abs(x) for x, _ in spots.values()) + 0.9
    figure = Figure(figsize=(7.2, 0.55 * (max(floor.values()) + 2)), layout="constrained")
    axes = figure.subplots()
    axes.set(xlim=(-wide, wide), ylim=(-1.5, max(floor.values()) + 0.5))
    axes.set_axis_off()
    for room, others in needed(below).items():
        for other in others:
            (x0, y0), (x1, y1) = spots[room], spots[other]
            arrow = {"arrowstyle": "-|>", "color": "0.6", "lw": 0.7}
            axes.annotate("", xy=(x1, y1 + _HEIGHT / 2), xytext=(x0, y0 - _HEIGHT / 2), arrowprops=arrow)
    box = {"boxstyle": "round,pad=0.35", "facecolor": "white", "edgecolor": "0.3", "linewidth": 0.8}
    for room, (x, y) in spots.items():
        axes.text(x, y, room, ha="center", va="center", fontsize=7.5, bbox=box)
    shade = {**box, "facecolor": "0.93", "edgecolor": "0.7"}
    axes.text(
        0, -1.0, "everywhere: " + ", ".join(sorted(base)), ha="center", va="center", fontsize=7, bbox=shade
    )
    return figure


def table() -> str:
    """Rooms from the top floor down: modules, lines, what each is for, what it imports directly."""
    below, known = arrows(), rooms()
    floor = floors(below)
    lines = ["| room | modules | lines | what it is | imports |", "|-|-|-|-|-|"]
    for room in sorted(known, key=lambda each: (-floor[each], each)):
        paths = known[room]
        count = sum(path.read_text(encoding="utf-8").count("\n") for path in paths)
        others = ", ".join(f"`{each}`" for each in sorted(below[room], key=lambda each: (-floor[each], each)))
        lines.append(f"| `{room}` | {len(paths)} | {count} | {_purpose(paths)} | {others} |")
    return "\n".join(lines) + "\n"


def _purpose(paths: list[Path]) -> str:
    first = next((path for path in paths if path.name == "__init__.py"), paths[0])
    text = ast.get_docstring(ast.parse(first.read_text(encoding="utf-8"))) or ""
    return text.split("\n\n")[0].replace("\n", " ").replace("|", "\\|")


def draw(path: Path) -> None:
    """The picture as SVG, the same bytes for the same imports."""
    with rc_context({"svg.hashsalt": "rooms", "svg.fonttype": "none"}):
        picture().savefig(path, metadata={"Date": None})
