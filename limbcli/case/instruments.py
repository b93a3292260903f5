"""The tables below a [[site]] of case.toml: files written by the instruments, and layers of the model."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from limbcli.case import schema as schema
from limbcli.case.files import CaseFiles
from limbcli.errors.problems import Problem


def read_instruments(
    values: Mapping[str, Any], files: CaseFiles, label: str
) -> tuple[dict[str, dict[str, Any]], list[Problem]]:
    """The tables that `limbcli measure` uses, with the path of the file or folder that each names."""
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
        problems += _at_odds(name, table, title, str(files.folder / "case.toml"))
        kind = "file" if "file" in keys else "folder"
        path, found = files.existing(table.get(kind), f"{title}: {kind}", is_folder=kind == "folder")
        problems += found
        tables[name] = {**table, "path": path}
    if "load_cell" not in tables and isinstance(values.get("trace"), str):
        usual, _ = schema.check_table({"file": values["trace"]}, schema.LOAD_CELL, name="", file="")
        tables["load_cell"] = {**usual, "path": files.folder / values["trace"]}
    return tables, problems


def _at_odds(name: str, table: Mapping[str, Any], title: str, file: str) -> list[Problem]:
    """Contradictions between two values of one table."""
    found = []
    if name == "load_cell" and table.get("probe_mass_kg") and table.get("tare_s") is None:
        fix = "add `tare_s = [from, to]`, the seconds in which the probe hung free; or remove probe_mass_kg"
        found.append(
            Problem(
                f"[{title}] has probe_mass_kg but no tare_s, which its weight is measured from", file, fix
            )
        )
    if name == "swe_images":
        found += _bar_ends_at_odds(table, title, file)
    return found


def _bar_ends_at_odds(table: Mapping[str, Any], title: str, file: str) -> list[Problem]:
    """The ends of the colour bar are all speeds or all moduli, and the low one is the smaller."""
    fix = (
        "give what the ends of the colour bar are marked with, high_m_per_s or high_kpa (Young's modulus, "
        "E = 3 rho v^2); high is its top, or its right end"
    )
    if (table.get("high_m_per_s") is None) == (table.get("high_kpa") is None):
        many = "both" if table.get("high_kpa") is not None else "neither"
        return [Problem(f"[{title}] has {many} of high_m_per_s and high_kpa", file, fix)]
    unit, other = ("m_per_s", "kpa") if table.get("high_kpa") is None else ("kpa", "m_per_s")
    low, high = table.get(f"low_{unit}") or 0.0, table[f"high_{unit}"]
    if table.get(f"low_{other}"):
        return [Problem(f"[{title}] has low_{other} beside high_{unit}", file, fix)]
    if low >= high:
        return [Problem(f"[{title}] low_{unit}, {low:g}, is not below high_{unit}, {high:g}", file, fix)]
    return []


def read_layers(
    tables: Mapping[str, Any] | None, label: str, file: str
) -> tuple[dict[str, dict[str, Any]], list[Problem]]:
    """The tables of `[site.layers]`: one for each layer (skin, fat) of the model."""
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
