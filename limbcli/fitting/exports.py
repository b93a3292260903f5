"""Identified parameters for other programs: CSV, MATLAB, and a piece of a FEBio file."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import savemat

from limbcli.feb.write import render
from limbcli.files.plain_text import write_rows
from limbcli.model import ElementMap, LimbModel, Material
from limbcli.results import StageWriter
from limbcli.site_model.indentation_model import TISSUE

PARAMETER_COLUMNS = (
    "site", "step", "parameter", "value", "standard_error", "low_95", "high_95", "flag", "words",
)  # fmt: skip
_LONGEST = 63  # greatest number of characters of a MATLAB field name


def write_exports(writer: StageWriter, rows: Sequence[Mapping[str, Any]], model: LimbModel) -> None:
    """Write parameters.csv and material.feb."""
    write_parameters(writer.file("parameters", "parameters.csv"), rows)
    writer.file("material", "material.feb").write_text(material_snippet(model), encoding="utf-8")


def parameter_rows(site: str, step: str, parameters: Mapping[str, Mapping[str, Any]]) -> list[dict[str, Any]]:
    """One row for each parameter, from the `parameters` of fit.json."""
    return [
        {
            "site": site, "step": step, "parameter": name, "value": each["value"],
            "standard_error": each.get("standard_error"), "low_95": each.get("low"),
            "high_95": each.get("high"), "flag": each["flag"], "words": each["words"],
        }
        for name, each in parameters.items()
    ]  # fmt: skip


def write_parameters(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write one row for each parameter; an empty interval bound means that the interval is open there."""
    write_table(path, {name: [row.get(name) for row in rows] for name in PARAMETER_COLUMNS})


def _cell(value: object) -> object:
    if value is None or (isinstance(value, float) and not np.isfinite(value)):
        return ""
    return f"{value:.8g}" if isinstance(value, float) else value


def write_mat_file(writer: StageWriter) -> None:
    """Write fit.mat with everything that the result contains; must be the last output of a fit."""
    write_mat(writer.file("mat", "fit.mat"), writer.data)


def write_mat(path: Path, content: Mapping[str, Any]) -> None:
    """Write a MATLAB 5 file with one struct `fit`; names that MATLAB does not allow are changed."""
    savemat(path, {"fit": _for_matlab(content)}, do_compression=True, long_field_names=True)


def _for_matlab(value: Any) -> Any:
    if isinstance(value, Mapping):
        names = _matlab_names([str(key) for key in value])
        return {name: _for_matlab(each) for name, each in zip(names, value.values(), strict=True)}
    if isinstance(value, np.ndarray):
        return value
    if isinstance(value, list | tuple):
        if all(isinstance(each, int | float | np.number) or each is None for each in value):
            return np.array([np.nan if each is None else float(each) for each in value])
        filled = np.empty(len(value), dtype=object)
        filled[:] = [_for_matlab(each) for each in value]
        return filled
    return np.nan if value is None else value


def _matlab_names(names: Sequence[str]) -> list[str]:
    """A distinct MATLAB field name for every name; numbers are appended where several would coincide.

    >>> _matlab_names(["bent-30", "bent.30", "bent_30_2"])
    ['bent_30', 'bent_30_3', 'bent_30_2']
    """
    fields = [_matlab_name(each) for each in names]
    for k, name in enumerate(fields):
        number = 2
        while fields[k] in fields[:k] or (number > 2 and fields[k] in fields[k + 1 :]):
            fields[k] = f"{name[: _LONGEST - len(str(number)) - 1]}_{number}"
            number += 1
    return fields


def _matlab_name(name: str) -> str:
    """
    >>> _matlab_name("mooney-rivlin"), _matlab_name("95 %")
    ('mooney_rivlin', 'x95__')
    """
    clean = re.sub(r"\W", "_", name)
    return (clean if clean[:1].isalpha() else f"x{clean}")[:_LONGEST]


def material_snippet(model: LimbModel) -> str:
    """The `<Material>` section of the model's FEBio file, with the tissue only."""
    law: Material = model.materials[TISSUE]
    text = render(model.with_material(TISSUE, law))
    found = re.search(r"<material\b[^>]*name=\"" + TISSUE + r"\".*?</material>", text, flags=re.S)
    assert found is not None, "a written model holds its tissue"
    mapped = any(isinstance(each, ElementMap) for each in law.parameters.values())
    maps = "; its maps are in fitted.feb, section MeshData" if mapped else ""
    return f"<!-- limbcli: identified tissue, mm-N-s (MPa){maps} -->\n{found.group(0)}\n"


def write_table(path: Path, columns: Mapping[str, Iterable[object]]) -> None:
    """Write columns of equal length to a CSV file."""
    write_rows(path, columns, (map(_cell, row) for row in zip(*columns.values(), strict=True)))
