"""A cohort: identify every row of a table with one family of models, then estimate the populations.

Each row of the table is a measurement at a site of a person. The results are `cohort.json`, `rows.csv`, and a
page with its pictures.
"""

from __future__ import annotations

import csv
import time
from pathlib import Path
from typing import Any

import numpy as np

from limbcli.cohorts.column_checks import checked_cohort
from limbcli.cohorts.compliance import compliance_left_out
from limbcli.cohorts.estimate import CohortNoise, SiteEstimate, estimate_sites, noise_of
from limbcli.cohorts.result import (
    UNTOLD_MUSCLE,
    UNTOLD_RATIO,
    family_ends,
    fat_words,
    m_beyond,
    outliers,
    row_entries,
    site_entry,
    summary_lines,
)
from limbcli.cohorts.sections import PICTURES, cohort_page, is_ours
from limbcli.cohorts.table import LAYERS, CohortTable
from limbcli.errors import CaseError, MeasurementError
from limbcli.errors.problems import checked, raise_errors
from limbcli.files.atomic import atomic_set, sha256
from limbcli.files.plain_text import text_cell
from limbcli.inference.layered_family import FORCE, LayeredFamily, layered_family
from limbcli.progress import SILENT, Progress
from limbcli.results import StageResult, check_seal, plain, provenance, record_of, write_sealed

STAGE, RESULT, ROWS, PAGE = "cohort", "cohort.json", "rows.csv", "cohort.html"
_RECORDED = (ROWS, PAGE)  # files whose hashes the result records, to check that all are of the same run
_ROWS_BEGIN = b"subject,location,line,"  # beginning of the header line of rows.csv
FEWEST_PEOPLE = 5  # least number of people at a site to estimate a population
FEWEST_DRAWS = 30  # least effective number of draws for a reliable interval
_MUCH_MISSED = 0.05  # error of the emulator, as a fraction of the force, above which a warning is given


def cohort(
    table: Path, *, out: Path, seed: int = 7, templates: Path | None = None, progress: Progress = SILENT
) -> StageResult:
    """Identify every row of a table, estimate each site's population, and predict left-out people.

    Raises as `limbcli.cohort`.
    """
    started = time.process_time()
    progress.event("stage", name="cohort")
    _refuse_foreign(out, table)
    read, problems = checked_cohort(table)
    raise_errors(problems, MeasurementError, then="then call `limbcli cohort` again")
    rows = checked(read, problems, MeasurementError)
    warnings = [f"{each.what} ({each.where})" for each in problems if each.severity == "warning"]
    rows, left_out_sites = _with_enough(rows)
    warnings += left_out_sites
    family = layered_family()
    noise = noise_of(rows)
    estimates = estimate_sites(rows, family, noise, seed=seed, progress=progress)
    seconds = time.process_time() - started
    progress.event("task", name="compliance of held-out people", done=0, total=1)
    predicted, words = compliance_left_out(rows, family, noise.slope, noise.layers.shortened, seed=seed)
    progress.event("task", name="compliance of held-out people", done=1, total=1)
    warnings = [*_trust(estimates, family), *words, *warnings]  # what bears on the results first
    data = _data(rows, family, noise, estimates, predicted, seconds)
    own = {**provenance(), "inputs_sha256": {table.name: sha256(table)}}
    content = plain(
        {"format": 1, "stage": STAGE, "table": table.name, **data, "warnings": warnings, "provenance": own}
    )
    with atomic_set(out, last=RESULT) as work:
        cohort_page(content, work, PAGE, templates=templates)
        with (work / ROWS).open("w", newline="", encoding="utf-8") as stream:
            writer = csv.DictWriter(stream, list(content["rows"][0]), lineterminator="\n")
            writer.writeheader()
            writer.writerows({k: text_cell(v) for k, v in row.items()} for row in content["rows"])
        content["provenance"]["files_sha256"] = {name: sha256(work / name) for name in _RECORDED}
        content = write_sealed(work / RESULT, content)
    return _result(out, content)


def _refuse_foreign(out: Path, table: Path) -> None:
    """Refuse to overwrite files of the user, such as the table itself, that have the names of our results."""
    rows = out / ROWS
    own_rows = rows.is_file() and not rows.read_bytes().startswith(_ROWS_BEGIN)
    pictures = out / PICTURES
    own_pictures = pictures.exists() and not (pictures.is_dir() and all(map(is_ours, pictures.iterdir())))
    mine = {each.resolve() for each in (rows, out / RESULT, out / PAGE)}
    found = [
        *([rows] if own_rows else []), *([pictures] if own_pictures else []),
        *([table] if table.resolve() in mine else []),
    ]  # fmt: skip
    if found:
        raise CaseError(
            f"{found[0].name} was not written by `cohort`, and would be replaced",
            where=str(found[0]),
            fix="name another --out",
        )


def _with_enough(table: CohortTable) -> tuple[CohortTable, list[str]]:
    """The table without sites that have too few people for a population, and warnings that name them."""
    counts = {site: len(set(table.person[table.site == site].tolist())) for site in table.sites}
    few = [site for site, n in counts.items() if n < FEWEST_PEOPLE]
    if len(few) == len(counts):
        raise MeasurementError(
            f"no site has complete rows of {FEWEST_PEOPLE} people "
            f"({', '.join(f'{k}: {n}' for k, n in counts.items())})",
            where=str(table.path),
            fix="a population needs more people: add their rows, or run `limbcli fit` on one case",
        )
    if not few:
        return table, []
    keep = ~np.isin(table.site.astype(str), few)
    return table.rows(keep), [
        f"{', '.join(few)}: complete rows of fewer than {FEWEST_PEOPLE} people, excluded from everything"
    ]


def _trust(estimates: list[SiteEstimate], family: LayeredFamily) -> list[str]:
    """Warnings that limit the validity of the results."""
    outside = sum(int((~each.model.inside).sum()) for each in estimates)
    thin = sum(int((each.found.effective < FEWEST_DRAWS).sum()) for each in estimates)
    ends = sum(int(each.model.at_an_end(each.found.mode).sum()) for each in estimates)
    beyond = ", ".join(each.name for each in estimates if m_beyond(each.population.mean))
    force_error = family.error[FORCE]
    words = (
        (outside, f"{outside} rows have a shape or a strain outside the family of simulations; its nearest "
         "member is used for them, and they are marked outside_family in rows.csv"),
        (beyond, f"{beyond}: the curves are straighter or more curved than for any m of the family, so "
         "that m is bounded on one side only; slopes and largest forces give no more information"),
        (ends, f"{ends} rows' tissue is at an end of the family ({family_ends()})"),
        (thin, f"{thin} rows: fewer than {FEWEST_DRAWS} effective draws for their interval; it "
         "is not reliable"),
        (force_error > _MUCH_MISSED,
         f"the emulator differs from the solver's force by {force_error:.0%} (one deviation)"),
    )  # fmt: skip
    return [text for holds, text in words if holds]


def _data(
    table: CohortTable, family: LayeredFamily, noise: CohortNoise, estimates: list[SiteEstimate],
    predicted: dict[str, Any], seconds: float,
) -> dict[str, Any]:  # fmt: skip
    rows = row_entries(table, estimates, predicted)
    return {
        "n_rows": len(table),
        "n_people": len(table.people),
        "n_incomplete": table.n_incomplete,
        "identification_processor_s_per_row": seconds / len(table),
        "noise": {
            "layer_shortened_mm": dict(zip(LAYERS, noise.layers.shortened, strict=True)),
            "edge_mm": dict(zip(LAYERS, noise.layers.edge, strict=True)),
            "from_data": dict(zip(LAYERS, noise.layers.from_data, strict=True)),
            "ln_stiffness": noise.slope,
            "ln_stiffness_from_data": noise.slope_from_data,
        },
        "emulator": {
            "n_solves": family.n_members,
            "n_solves_on_finer_mesh": family.n_fine,
            "left_out_error": {
                "force_percent": 100 * family.error[0],
                "convexity": family.error[1],
                "logit_muscle_part": family.error[2],
                "skin_part": family.error[3],
            },
        },
        "fat_stiffness": {
            "determined": False,
            "words": fat_words(table, estimates),
            "untold_ratio_factor": UNTOLD_RATIO,
            "untold_c_muscle_factor": UNTOLD_MUSCLE,
        },
        "sites": {each.name: site_entry(table, each) for each in estimates},
        "stands_out": outliers(table, estimates),
        "compliance_left_out": predicted,
        "rows": rows,
    }


def _result(out: Path, content: dict[str, Any]) -> StageResult:
    return StageResult(
        stage=STAGE,
        subject=Path(content["table"]).stem,
        folder=out,
        files={"result": RESULT, "rows": ROWS, "page": PAGE},
        data=content,
        summary=tuple(summary_lines(content, out / PAGE)),
        warnings=tuple(content["warnings"]),
        provenance=content["provenance"],
    )


def read_cohort(out: Path) -> StageResult:
    """Read the result of an earlier run from `out`.

    Raises CaseError if it is missing or unreadable, or if the table and the page are not of the same run as
    the result.
    """
    with record_of(out / RESULT, STAGE, f"limbcli cohort TABLE --out {out}") as content:
        check_seal(content)
        found = _result(out, content)
        recorded = {name: found.provenance["files_sha256"][name] for name in _RECORDED}
    for name, digest in recorded.items():
        if not (out / name).is_file() or sha256(out / name) != digest:
            raise CaseError(
                f"{name} is not the file that `cohort` wrote together with {RESULT}",
                where=str(out / name),
                fix=f"run `limbcli cohort TABLE --out {out}` again: a run may have been interrupted at its "
                f"end",
            )
    return found
