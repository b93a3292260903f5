"""The rooms' arrows: imports point down, and only to rooms that are listed here."""

from __future__ import annotations

import ast
import functools
import re
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parents[1] / "limbcli"
GROUND = {"background_processes", "case", "config", "drawing", "errors", "files", "model", "numbers",
          "options", "progress", "results", "surface_formats", "version"}  # fmt: skip
SIBLINGS = {"imaging", "measurement", "meshing", "inference"}
ALLOWED: dict[str, set[str]] = {
    "measurement": set(),
    "meshing": set(),
    "inference": set(),
    "materials": set(),
    "provenance": set(),
    "imaging": {"meshing"},
    "feb": {"materials", "fem"},
    "fem": {"materials"},
    "solvers": {"feb", "fem", "materials"},
    "shear_waves": {"materials", "measurement", "solvers"},
    "effects": {"materials", "meshing", "shear_waves", "inference"},
    "stiffness_field": {"measurement", "meshing"},
    "reporting": {"measurement"},
    "phantom": {"imaging", "measurement", "materials", "meshing", "shear_waves"},
    "sockets": {"meshing", "materials", "solvers", "feb", "fem"},
    "cohorts": {"solvers", "feb", "reporting", "measurement", "meshing", "inference", "materials"},
    "site_model": SIBLINGS | {"effects", "feb", "materials", "provenance", "solvers"},
    "fitting": SIBLINGS
    | {"effects", "feb", "materials", "provenance", "reporting", "shear_waves", "site_model", "solvers"},
    "diagnosis": {"effects", "feb", "measurement", "meshing", "shear_waves", "site_model", "solvers"},
    "stages": SIBLINGS
    | {"effects", "feb", "materials", "phantom", "reporting", "shear_waves", "sockets", "solvers"}
    | {"stiffness_field", "diagnosis", "fitting", "site_model", "provenance", "cohorts"},
    "cli": {"api", "stages", "site_model"},
    "api": {"stages", "solvers", "feb", "fitting", "site_model"},
    "__init__": {"api", "solvers", "feb"},
}
KNOW_CASE = {
    "stages",
    "cli",
    "api",
    "__init__",
    "reporting",
    "case",
    "phantom",
    "site_model",
    "fitting",
    "diagnosis",
    "provenance",
}


def room_of(path: Path) -> str:
    parts = path.relative_to(PACKAGE).parts
    return parts[0] if len(parts) > 1 else path.stem


@functools.cache
def imports_of(path: Path) -> list[tuple[int, str]]:
    """(line, dotted name below limbcli) of every import, also those inside functions."""
    found = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] == "limbcli":
            below = node.module.split(".")[1:]
            found += (
                [(node.lineno, ".".join(below))] if below else [(node.lineno, n.name) for n in node.names]
            )
        elif isinstance(node, ast.Import):
            names = [each.name for each in node.names if each.name.startswith("limbcli.")]
            found += [(node.lineno, name.removeprefix("limbcli.")) for name in names]
    return found


SOURCES = sorted(PACKAGE.rglob("*.py"))


def test_imports_point_down():
    wrong = []
    for path in SOURCES:
        room = room_of(path)
        for line, name in imports_of(path):
            target = name.split(".")[0]
            if target not in GROUND | {room, *ALLOWED.get(room, ())} and room != "__main__":
                wrong.append(f"{path.relative_to(PACKAGE)}:{line} {room} -> {target}")
    assert not wrong, "\n".join(wrong)


def test_rooms_that_know_no_site_do_not_know_the_case():
    for path in SOURCES:
        if room_of(path) not in KNOW_CASE:
            assert not [name for _, name in imports_of(path) if name in ("case", "case.parts")], path


def test_no_two_rooms_import_each_other_in_a_circle():
    """Not by way of others either, and not inside functions."""
    below: dict[str, set[str]] = {}
    for path in SOURCES:
        room = room_of(path)
        if not room.startswith("__"):
            below.setdefault(room, set()).update(name.split(".")[0] for _, name in imports_of(path))
    for room, others in below.items():
        others.discard(room)
    assert len(list(TopologicalSorter(below).static_order())) >= len(below)  # a circle raises CycleError


@pytest.mark.parametrize(("one", "other"), [("fitting", "diagnosis"), ("diagnosis", "fitting")])
def test_what_fits_and_diagnosis_share_is_in_rooms_below_both(one: str, other: str):
    for path in sorted((PACKAGE / one).rglob("*.py")):
        assert not [name for _, name in imports_of(path) if name.split(".")[0] == other], path


def test_ground_floor_imports_nothing_above():
    for path in SOURCES:
        if room_of(path) in GROUND:
            assert {name.split(".")[0] for _, name in imports_of(path)} <= GROUND, path


def test_the_list_for_newcomers_names_every_module_on_the_ground_floor():
    text = (PACKAGE.parent / "CONTRIBUTING.md").read_text(encoding="utf-8")
    modules = {path.stem for path in PACKAGE.glob("*.py") if not path.stem.startswith("__")}
    packages = {name for name in GROUND if (PACKAGE / name).is_dir()}
    assert modules | packages == GROUND
    assert not [name for name in modules if f" {name}.py " not in text]
    assert not [name for name in packages if f" {name}/ " not in text]


def test_nothing_below_the_command_line_prints():
    """But what shows the progress of a call from Python."""
    for path in SOURCES:
        if room_of(path) in {"cli", "__main__"} or path.parts[-2:] == ("api", "notebook.py"):
            continue
        text = path.read_text(encoding="utf-8")
        if not re.search(r"\b(print|exit)\s*\(", text):
            continue
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
                assert node.func.id not in {"print", "exit"}, f"{path}:{node.lineno}"
