"""`limbcli cohort TABLE.csv --out DIR`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from limbcli.cli.options import JsonOpt, NoWaitOpt, QuietOpt, TemplatesOpt, VerboseOpt
from limbcli.cli.terminal import emit, terminal
from limbcli.output_lock import one_writer

TableArg = Annotated[
    Path, typer.Argument(metavar="TABLE.csv", help="One row per person and site.", show_default=False)
]
OutOpt = Annotated[
    Path | None,
    typer.Option(
        "--out", "-o", metavar="DIR", help="Output folder; default: out/<name of TABLE>.", show_default=False
    ),
]
SeedOpt = Annotated[int, typer.Option("--seed", min=0, help="Random seed of the folds and of the sampling.")]


def command(
    table: TableArg,
    out: OutOpt = None,
    seed: SeedOpt = 7,
    templates: TemplatesOpt = None,
    no_wait: NoWaitOpt = False,
    json: JsonOpt = False,
    quiet: QuietOpt = False,
    verbose: VerboseOpt = 0,
) -> None:
    """Estimate the tissue of many people from layers, force and slope; no MRI or wave speeds needed.

    Every row is fitted with a layered slab whose simulations ship with limbcli; the population of each site
    is estimated, and the compliance of held-out people is predicted from thicknesses, in ten folds by person.

    Required columns: subject, location, max_force_n, max_pressure_mpa (or face_mm2), thickness_mm,
    skin_mm, fat_mm, muscle_mm, total_strain, skin_strain, fat_strain, muscle_strain, stiffness_mpa_per_mm.
    Optional: trial, circumference_mm, age_years, sex, bmi_kg_per_m2, r2_line, r2_parabola. docs/cohort.md
    describes each. Strains are shortening over thickness at the largest force.

    Writes cohort.json, rows.csv, cohort.html and pictures/ in DIR.
    """
    from limbcli.config import default_out
    from limbcli.stages.cohort import cohort

    target = out or default_out(table.with_suffix(""))
    progress = terminal(quiet=quiet, verbose=verbose)
    with one_writer(target, wait=not no_wait, progress=progress):
        result = cohort(table, out=target, seed=seed, templates=templates, progress=progress)
    emit(result, as_json=json)
