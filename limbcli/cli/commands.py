"""All commands, in the order in which a new user needs them.

The modules behind a command are imported when it is made, and a start of the program makes only the one that
it is asked for.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import Any


@dataclass(frozen=True)
class Command:
    """A command: the function that declares its options and does its work, and what its help shows.

    function : "module:name", within limbcli
    example : a command line, below the help
    text : help; default: the function's own documentation
    like : functions whose options it takes too
    """

    function: str
    example: str
    text: str = ""
    like: tuple[str, ...] = ()

    def functions(self) -> list[Callable[..., Any]]:
        """The command's own function, then those whose options it takes too."""
        places = (each.split(":") for each in (self.function, *self.like))
        return [getattr(import_module(f"limbcli.{module}"), name) for module, name in places]

    def help(self) -> str:
        return self.text or inspect.getdoc(self.functions()[0]) or ""


COMMANDS = {
    "doctor": Command("cli.command_functions:check_machine", "limbcli doctor --febio /opt/febio/bin/febio4"),
    "new": Command("cli.command_functions:new_case", "limbcli new S12 --site p1 --site p2"),
    "check": Command("cli.command_functions:check_case", "limbcli check S12"),
    "measure": Command(
        "api.subjects:measure", "limbcli measure S12 --site p1 --write",
        "Convert the load-cell record, B-mode and elastography images to the rows of levels.csv.",
    ),
    "segment": Command(
        "cli.command_functions:segment_case", "limbcli segment S12 --limb left --seed bone=12,40,-60",
        like=("api.geometry:segment",),
    ),
    "mesh": Command(
        "api.geometry:mesh", "limbcli mesh S12 --site p1 --size-mm 3",
        "Build the local finite-element model of a site from the surfaces.",
    ),
    "build-feb": Command(
        "api.simulation:build_feb", "limbcli build-feb S12 --c-kpa 8 --out results/S12",
        "Write the mesh and the measurement as a FEBio model, using templates.",
    ),
    "run": Command(
        "cli.command_functions:run_case_or_file", "limbcli run S12 --solver reference",
        like=("api.simulation:run",),
    ),
    "fit": Command(
        "cli.command_functions:fit_by_objective", "limbcli fit S12 --site p1 --compare-element",
        like=("api.fitting:fit", "api.fitting:fit_joint"),
    ),
    "diagnose": Command(
        "api.diagnosis:diagnose", "limbcli diagnose S12 --site p1 --measured tare_n=0.4",
        "Find where model and measurement disagree, what is missing, and what to measure next.",
    ),
    "limb": Command(
        "api.whole_limb:limb", "limbcli limb S12 --nodes 20000",
        "Build the finite-element model of the whole limb, with named parts, for FEBio and others.",
    ),
    "socket": Command(
        "api.whole_limb:socket", "limbcli socket S12 --align",
        "Put the limb into its socket and load it: pressure and shear on the skin, by patch. After `limb`.",
    ),
    "report": Command(
        "cli.command_functions:report_case_or_index", "limbcli report S12 --out results/S12",
        like=("api.diagnosis:report",),
    ),
    "batch": Command(
        "cli.batch:batch_cases", "limbcli batch S12 S13 --out results", like=("api.cohorts:batch",)
    ),
    "cohort": Command(
        "api.cohorts:cohort", "limbcli cohort people.csv --out results/people",
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
        "api.making:make_phantom", "limbcli phantom subject --seed 7 --max-force-n 10",
        "Create a synthetic subject with known truth: MRI, measurements, truth.",
    ),
    "synth": Command(
        "api.making:synth", "limbcli synth S12 --out-case S12-known --c-kpa 8 --m 6 --noise 0",
        "Simulate measurements with known parameters on the geometry of an existing case, as a new case.",
    ),
}  # fmt: skip
