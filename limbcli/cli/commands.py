"""All commands, in the order in which a new user needs them."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from limbcli.api.cohorts import batch, cohort
from limbcli.api.diagnosis import diagnose, report
from limbcli.api.fitting import fit, fit_joint
from limbcli.api.geometry import mesh, segment
from limbcli.api.in_socket import socket
from limbcli.api.making import make_phantom, synth
from limbcli.api.simulation import build_feb, run
from limbcli.api.subjects import measure
from limbcli.api.whole_limb import limb
from limbcli.cli.batch import batch_cases
from limbcli.cli.check import check_case
from limbcli.cli.doctor import check_machine
from limbcli.cli.fit import fit_by_objective
from limbcli.cli.new import new_case
from limbcli.cli.report import report_case_or_index
from limbcli.cli.run import run_case_or_file
from limbcli.cli.segment import segment_case


@dataclass(frozen=True)
class Command:
    """A command: the function that declares its options and does its work, and what its help shows.

    example : a command line, below the help
    text : help; default: the function's own documentation
    like : functions whose options it takes too
    """

    function: Callable[..., Any]
    example: str
    text: str = ""
    like: tuple[Callable[..., Any], ...] = ()

    @property
    def help(self) -> str:
        return self.text or inspect.getdoc(self.function) or ""


COMMANDS = {
    "doctor": Command(check_machine, "limbcli doctor --febio /opt/febio/bin/febio4"),
    "new": Command(new_case, "limbcli new S12 --site p1 --site p2"),
    "check": Command(check_case, "limbcli check S12"),
    "measure": Command(
        measure, "limbcli measure S12 --site p1 --write",
        "Convert the load-cell record, B-mode and elastography images to the rows of levels.csv.",
    ),
    "segment": Command(
        segment_case, "limbcli segment S12 --limb left --seed bone=12,40,-60", like=(segment,)
    ),
    "mesh": Command(
        mesh, "limbcli mesh S12 --site p1 --size-mm 3",
        "Build the local finite-element model of a site from the surfaces.",
    ),
    "build-feb": Command(
        build_feb, "limbcli build-feb S12 --c-kpa 8 --out results/S12",
        "Write the mesh and the measurement as a FEBio model, using templates.",
    ),
    "run": Command(run_case_or_file, "limbcli run S12 --solver reference", like=(run,)),
    "fit": Command(
        fit_by_objective, "limbcli fit S12 --site p1 --compare-element", like=(fit, fit_joint)
    ),
    "diagnose": Command(
        diagnose, "limbcli diagnose S12 --site p1 --measured tare_n=0.4",
        "Find where model and measurement disagree, what is missing, and what to measure next.",
    ),
    "limb": Command(
        limb, "limbcli limb S12 --nodes 20000",
        "Build the finite-element model of the whole limb, with named parts, for FEBio and others.",
    ),
    "socket": Command(
        socket, "limbcli socket S12 --align",
        "Put the limb into its socket and load it: pressure and shear on the skin, by patch. After `limb`.",
    ),
    "report": Command(report_case_or_index, "limbcli report S12 --out results/S12", like=(report,)),
    "batch": Command(batch_cases, "limbcli batch S12 S13 --out results", like=(batch,)),
    "cohort": Command(
        cohort, "limbcli cohort people.csv --out results/people",
        """Estimate the tissue of many people from layers, force and slope; no MRI or wave speeds needed.

    Every row is fitted with a layered slab whose simulations ship with limbcli; the population of each site
    is estimated, and the compliance of held-out people is predicted from thicknesses, in ten folds by person.

    Required columns: subject, location, max_force_n, max_pressure_mpa (or face_mm2), thickness_mm,
    skin_mm, fat_mm, muscle_mm, total_strain, skin_strain, fat_strain, muscle_strain, stiffness_mpa_per_mm.
    Optional: trial, circumference_mm, age_years, sex, bmi_kg_per_m2, r2_line, r2_parabola. docs/cohort.md
    describes each. Strains are shortening over thickness at the largest force.

    Writes cohort.json, rows.csv, cohort.html and pictures/ in DIR.
    """,
    ),
    "phantom": Command(
        make_phantom, "limbcli phantom subject --seed 7 --max-force-n 10",
        "Create a synthetic subject with known truth: MRI, measurements, truth.",
    ),
    "synth": Command(
        synth, "limbcli synth S12 --out-case S12-known --c-kpa 8 --m 6 --noise 0",
        "Simulate measurements with known parameters on the geometry of an existing case, as a new case.",
    ),
}  # fmt: skip
