"""The table of a cohort, people and sites each indented once (or a few times), as read by `limbcli cohort`.

One row: the layers under the probe at first contact, the shortening of each at the largest force, that force,
and the slope of pressure over displacement. No image, limb geometry or wave speed is needed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from limbcli.errors.problems import Problem, similar
from limbcli.measurement.number_table import RawTable, header_of, problem, read_table
from limbcli.model import Array

LAYERS = ("skin", "fat", "muscle")
PERSON, SITE, TRIAL, SEX = "subject", "location", "trial", "sex"
# Alternative names of the text columns, used if their own is missing.
_ALSO = {"person": PERSON, "site": SITE}
FACE, PRESSURE = "face_mm2", "max_pressure_mpa"
OF_PERSON = ("age_years", "bmi_kg_per_m2")  # used in a second prediction, if every row gives them

REQUIRED: Mapping[str, str] = {
    "max_force_n": "largest normal force of the probe",
    "thickness_mm": "skin to bone at first contact",
    "skin_mm": "skin at first contact",
    "fat_mm": "fat at first contact",
    "muscle_mm": "muscle at first contact; the three layers add up to the thickness",
    "total_strain": "shortening of the whole over thickness_mm, at the largest force",
    "skin_strain": "shortening of the skin over skin_mm, at the largest force",
    "fat_strain": "the same of the fat",
    "muscle_strain": "the same of the muscle; the three shortenings add up to the whole's",
    "stiffness_mpa_per_mm": "slope of pressure over displacement: of the line from first contact on",
}
OPTIONAL: Mapping[str, str] = {
    FACE: "area of the probe's face; or max_pressure_mpa",
    PRESSURE: "largest force over the face: gives the face where face_mm2 is missing",
    "circumference_mm": "of the limb at the site (checked against the layers)",
    "age_years": "used in a second prediction of compliance",
    "bmi_kg_per_m2": "used in a second prediction of compliance",
    "r2_line": "R2 of the line through the record",
    "r2_parabola": "R2 of a parabola: with r2_line, what the slope's own noise is",
}
TEXTS: Mapping[str, str] = {
    PERSON: "the person (or `person`); never a name",
    SITE: "the place on the body (or `site`)",
    TRIAL: "optional: which repetition, where a person's site was measured more than once",
    SEX: "optional, any two words; used in a second prediction of compliance",
}


@dataclass(frozen=True, eq=False, kw_only=True)
class CohortTable:
    """Complete rows; arrays (n_rows,). face mm2; thickness, shortened (n_rows, 3: skin, fat, muscle) mm.

    slope : MPa/mm; others : optional numeric columns (NaN where empty); lines : line numbers in the file
    n_incomplete : number of rows omitted because a reading is missing
    """

    person: Array
    site: Array
    trial: Array
    sex: Array
    force: Array
    face: Array
    thickness: Array
    shortened: Array
    slope: Array
    others: Mapping[str, Array]
    lines: Array
    path: Path
    n_incomplete: int = 0

    def __len__(self) -> int:
        return len(self.force)

    @property
    def whole(self) -> Array:
        """Distance from skin to bone (mm)."""
        return np.asarray(self.thickness.sum(axis=1))

    @property
    def depth(self) -> Array:
        """Indentation depth (mm): the shortening of the whole."""
        return np.asarray(self.shortened.sum(axis=1))

    @property
    def compliance(self) -> Array:
        """Inverse of the slope, mm/MPa."""
        return np.asarray(1.0 / self.slope)

    @property
    def sites(self) -> list[str]:
        return sorted(set(self.site.tolist()))

    @property
    def people(self) -> list[str]:
        return sorted(set(self.person.tolist()))

    def rows(self, keep: NDArray[Any]) -> CohortTable:
        """The rows selected by `keep` (mask or indices)."""
        arrays = [each.name for each in fields(self) if each.type == "Array"]
        parts = {name: getattr(self, name)[keep] for name in arrays}
        return replace(self, **parts, others={name: each[keep] for name, each in self.others.items()})


def read_cohort(path: Path) -> tuple[RawTable | None, list[Problem]]:
    """The table's columns as read, and every problem of its format.

    Unknown columns are ignored, with a warning that names the most similar known one.
    """
    if not path.is_file():
        return None, [problem("the table was not found", path, "give a CSV file with the documented columns")]
    known = {*REQUIRED, *OPTIONAL, *TEXTS}
    header = header_of(path, known | set(_ALSO))
    also = {name: meant for name, meant in _ALSO.items() if meant not in header}
    spare = {each for each in header if each and each not in known | set(also)}
    texts = {*TEXTS, *also, *spare}
    optional = {*OPTIONAL, *(REQUIRED.keys() & set(header))}
    required = [] if header else [*REQUIRED]  # missing columns are reported separately, with their meaning
    table, problems = read_table(path, required=required, optional=optional, texts=texts)
    problems = [*_lacking(header, path), *problems] if header else problems
    for name in sorted(spare):
        fix = similar(name, known) or "none needed, if this is intended"
        problems.append(problem(f"column {name!r} is not used", path, fix, line=1, warning=True))
    if table is None:
        return None, problems
    columns = {also.get(name, name): each for name, each in table.texts.items() if name not in spare}
    return replace(table, texts=columns), problems


def _lacking(header: list[str], path: Path) -> list[Problem]:
    """Missing columns, each with its meaning."""
    found = []
    for name in (PERSON, SITE):
        if name not in header and not any(_ALSO.get(each) == name for each in header):
            found.append(problem(f"column {name!r} is missing", path, f"add it: {TEXTS[name]}", line=1))
    for name in REQUIRED:
        if name not in header:
            found.append(problem(f"column {name!r} is missing", path, f"add it: {REQUIRED[name]}", line=1))
    if FACE not in header and PRESSURE not in header:
        fix = f"add {FACE}, the area of the probe's face, or {PRESSURE}, the force over it"
        found.append(problem("the probe's face area is not known", path, fix, line=1))
    return sorted(found, key=lambda each: each.what)
