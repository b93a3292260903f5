"""The tables below a [[site]] of case.toml: the instruments' own files, and layers of the model."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from limbcli.case import schema as schema
from limbcli.case.files import CaseFiles
from limbcli.errors.problems import Problem


def read_instruments(
    values: Mapping[str, Any], files: CaseFiles, label: str
) -> tuple[dict[str, dict[str, Any]], list[Problem]]:
    """The tables that `limbcli measure` reads, with the path of the file or folder each names."""
    tables: dict[str, dict[str, Any]] = {}
    problems: list[Problem] = []
    for name, keys in schema.INSTRUMENTS.items():
        if values.get(name) is None:
            continue
        title = f"{label} {name}"
        table, found = schema.check_table(
            values[name], keys, name=title, file=str(files.folder / "case.toml")
        )
        problems += found
        kind = "file" if "file" in keys else "folder"
        path, found = files.existing(table.get(kind), f"{title}: {kind}", is_folder=kind == "folder")
        problems += found
        tables[name] = {**table, "path": path}
    if "load_cell" not in tables and isinstance(values.get("trace"), str):
        usual, _ = schema.check_table({"file": values["trace"]}, schema.LOAD_CELL, name="", file="")
        tables["load_cell"] = {**usual, "path": files.folder / values["trace"]}
    return tables, problems


def read_layers(
    tables: Mapping[str, Any] | None, label: str, file: str
) -> tuple[dict[str, dict[str, Any]], list[Problem]]:
    """The tables of `[site.layers]`: one for each of skin and fat that the model is to have."""
    layers: dict[str, dict[str, Any]] = {}
    problems: list[Problem] = []
    for name, table in (tables or {}).items():
        title = f"{label} layers.{name}"
        if name not in schema.LAYER_NAMES:
            fix = f"the layers are {' and '.join(schema.LAYER_NAMES)}"
            problems.append(Problem(f"unknown layer {name!r} in [{label} layers]", file, fix))
            continue
        layers[name], found = schema.check_table(table, schema.LAYER, name=title, file=file)
        problems += found
    return layers, problems
