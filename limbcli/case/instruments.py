"""The tables below a [[site]] of case.toml: files written by the instruments, and layers of the model."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from limbcli.case import schema as schema
from limbcli.case.reading import CaseReading


def read_instruments(
    values: Mapping[str, Any], reading: CaseReading, label: str
) -> dict[str, dict[str, Any]]:
    """The tables that `limbcli measure` uses, with the path of the file or folder that each names."""
    tables: dict[str, dict[str, Any]] = {}
    for name, keys in schema.INSTRUMENTS.items():
        if values.get(name) is None:
            continue
        title = f"{label} {name}"
        table = reading.table(values[name], keys, title)
        _check_agreement(name, table, title, reading)
        kind = "file" if "file" in keys else "folder"
        path = reading.existing(table.get(kind), f"{title}: {kind}", is_folder=kind == "folder")
        tables[name] = {**table, "path": path}
    if "load_cell" not in tables and isinstance(values.get("trace"), str):
        usual, _ = schema.check_table({"file": values["trace"]}, schema.LOAD_CELL, name="", file="")
        tables["load_cell"] = {**usual, "path": reading.folder / values["trace"]}
    return tables


def _check_agreement(name: str, table: Mapping[str, Any], title: str, reading: CaseReading) -> None:
    """Two values of one table must not contradict each other."""
    if name == "load_cell" and table.get("probe_mass_kg") and table.get("tare_s") is None:
        fix = "add `tare_s = [from, to]`, the seconds in which the probe hung free; or remove probe_mass_kg"
        reading.wrong(f"[{title}] has probe_mass_kg but no tare_s, which its weight is measured from", fix)
    if name == "swe_images":
        _check_bar_ends(table, title, reading)


def _check_bar_ends(table: Mapping[str, Any], title: str, reading: CaseReading) -> None:
    """The ends of the colour bar are all speeds or all moduli, and the low one is the smaller."""
    fix = (
        "give what the ends of the colour bar are marked with, high_m_per_s or high_kpa (Young's modulus, "
        "E = 3 rho v^2); high is its top, or its right end"
    )
    if (table.get("high_m_per_s") is None) == (table.get("high_kpa") is None):
        many = "both" if table.get("high_kpa") is not None else "neither"
        return reading.wrong(f"[{title}] has {many} of high_m_per_s and high_kpa", fix)
    unit, other = ("m_per_s", "kpa") if table.get("high_kpa") is None else ("kpa", "m_per_s")
    low, high = table.get(f"low_{unit}") or 0.0, table[f"high_{unit}"]
    if table.get(f"low_{other}"):
        reading.wrong(f"[{title}] has low_{other} beside high_{unit}", fix)
    elif low >= high:
        reading.wrong(f"[{title}] low_{unit}, {low:g}, is not below high_{unit}, {high:g}", fix)
    return None


def read_layers(
    tables: Mapping[str, Any] | None, label: str, reading: CaseReading
) -> dict[str, dict[str, Any]]:
    """The tables of `[site.layers]`: one for each layer (skin, fat) of the model."""
    layers: dict[str, dict[str, Any]] = {}
    for name, table in (tables or {}).items():
        if name in schema.LAYER_NAMES:
            layers[name] = reading.table(table, schema.LAYER, f"{label} layers.{name}")
        else:
            fix = f"the layers are {' and '.join(schema.LAYER_NAMES)}"
            reading.wrong(f"unknown layer {name!r} in [{label} layers]", fix)
    return layers
