"""FEBio's public test suite through our reader and the reference solver, as a table.

    python -m tests.benchmarks.febio_suite FOLDER [--sample 20 --seed 7] [--out FILE]

FOLDER is a copy of https://github.com/febiosoftware/TestSuite. Which of its files are in scope is decided by
`out_of_scope` from what they contain, never by their names. Each is read, run from rest to its end, and
compared with the suite's value: the Euclidean norm of the solver's total solution vector after the last step
(FEBio's task "test": FELogSolutionNorm, FENewtonSolver::GetSolutionVector), i.e. of the displacements of all
free degrees of freedom, those of rigid bodies counted from the start of the last step.

With --out the rows are kept, and a later call goes on from them.
"""

from __future__ import annotations

import argparse
import ast
import re
import signal
import time
from collections import Counter
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from lxml import etree

from limbcli.errors import LimbError
from limbcli.feb.law_tags import tag_of_febio
from limbcli.feb.read import read_feb
from limbcli.feb.read_mesh import TYPES_WITH_RULE
from limbcli.fem.analysis import Analysis, Snapshot
from limbcli.fem.motion.rigid import whole_rotation
from limbcli.model import NODES_PER_CELL, SOLID_KINDS
from limbcli.solvers.reference import prepare
from tests.benchmarks.seeded_rows import made

NEAR = 1e-3  # relative difference from the suite's value that counts as agreement
_SMALL = 1e-6  # norms below this are compared absolutely: of some files it is round-off of 0
_SECTIONS = {
    "Module", "Control", "Globals", "Material", "Mesh", "MeshDomains", "MeshData", "Boundary", "Rigid",
    "Loads", "Contact", "Step", "LoadData", "Output",
}  # fmt: skip
_CONDITIONS = {
    "zero displacement", "prescribed displacement", "rigid", "zero rotation", "zero shell displacement"
}  # fmt: skip
_RIGID = {
    "rigid_fixed", "rigid_displacement", "rigid_rotation", "rigid_rotation_vector", "rigid_force",
    "rigid_moment", "rigid spring",
}  # fmt: skip
_LOADS = {"pressure", "traction", "force", "nodal_force", "nodal_load", "const", "non-const", "body force"}
_RULES = {None, "default", "TET10G8", "TET10G4", "TET4G1", "HEX8G8", "PENTA6G6"}
_DOMAINS = {None, "elastic-solid", "three-field-solid"}
_OF_PARTS = ("solid", "elastic")


def gold_values(folder: Path) -> dict[str, float]:
    """The suite's values for Linux by the names of the files."""
    text = (folder / "code" / "linuxGoldStandards.py").read_text()
    found = ast.literal_eval(text[text.index("{") : text.rindex("}") + 1])
    values = {name: row[6] for name, row in found.items() if len(row) > 6}
    return {name: float(value) for name, value in values.items() if value}


# ---------------------------------------------------------------- scope


def out_of_scope(root: etree._Element) -> list[str]:
    """Why a file is outside: solid mechanics at rest, by elements and laws of the reference solver, contact
    in one pass against a rigid side, rigid bodies, loads on surfaces, nodes and volumes. Empty: it is in
    scope."""
    if root.get("version") != "4.0":
        return [f"format {root.get('version')}"]
    module = root.find("Module")
    if module is None or module.get("type") != "solid":
        return [f"module {module.get('type') if module is not None else None}"]
    why = [
        f"<{each.tag}>" for each in _elements(root, *root.iterfind("Step/step")) if each.tag not in _SECTIONS
    ]
    why += _analyses(root)
    why += _materials(root)
    why += _parts(root)
    why += _conditions(root)
    why += _contacts(root)
    logged = root.find("Output/logfile")
    if logged is not None and any(each.get("file") is None for each in _elements(logged)):
        why.append("the suite compares another quantity")
    return sorted(set(why))


def _elements(*owners: etree._Element) -> list[etree._Element]:
    """The children that are elements, without empty ones."""
    return [
        each
        for owner in owners
        for each in owner
        if isinstance(each.tag, str) and (len(each) or each.attrib or (each.text or "").strip())
    ]


def _analyses(root: etree._Element) -> list[str]:
    why = []
    for control in root.iter("Control"):
        kind = (control.findtext("analysis") or "STATIC").strip().upper()
        solver = control.find("solver")
        if kind not in ("STATIC", "0"):
            why.append(f"analysis {kind}")
        if solver is not None and solver.get("type") not in (None, "solid"):
            why.append(f"solver {solver.get('type')}")
        if (control.findtext("solver/arc_length") or "0").strip() not in ("0", "false"):
            why.append("arc-length method")
    return why


def _materials(root: etree._Element) -> list[str]:
    why = []
    for each in root.iterfind("Material/material"):
        if each.get("type") != "rigid body":
            why += [f"material {name}" for name in _laws(each) if not _is_known(name)]
    return why


def _laws(tag: etree._Element) -> list[str]:
    inner = [name for part in tag if part.tag in _OF_PARTS for name in _laws(part)]
    return [str(tag.get("type")), *inner]


def _is_known(name: str) -> bool:
    law = tag_of_febio(name)
    return law is not None and law.law != "biphasic"


def _parts(root: etree._Element) -> list[str]:
    materials = {each.get("name"): each for each in root.iterfind("Material/material")}
    kinds = {each.get("name"): str(each.get("type")) for each in root.iterfind("Mesh/Elements")}
    why = []
    for name, kind in kinds.items():
        if TYPES_WITH_RULE.get(kind, kind) not in NODES_PER_CELL:
            why.append(f"element {kind}, {name}".split(",")[0])
    for domain in _elements(*root.iterfind("MeshDomains")):
        material = materials.get(domain.get("mat"))
        kind = TYPES_WITH_RULE.get(str(kinds.get(domain.get("name"))), kinds.get(domain.get("name")))
        if material is not None and material.get("type") == "rigid body":
            continue
        if kind not in SOLID_KINDS:
            why.append("deformable shells, beams or trusses")
        elif domain.get("type") not in _DOMAINS or domain.get("elem_type") not in _RULES:
            why.append(f"element formulation {domain.get('type') or domain.get('elem_type')}")
    return why


def _conditions(root: etree._Element) -> list[str]:
    def others(known: set[str], tags: Iterable[etree._Element], what: str) -> list[str]:
        return [f"{what} {each.get('type')}" for each in tags if each.get("type") not in known]

    return [
        *others(_CONDITIONS, root.iter("bc"), "boundary condition"),
        *others(
            _RIGID, (t for n in ("rigid_bc", "rigid_load", "rigid_connector") for t in root.iter(n)), "rigid"
        ),
        *others(
            _LOADS, (t for n in ("surface_load", "nodal_load", "body_load") for t in root.iter(n)), "load"
        ),
        *others({"loadcurve", "math"}, root.iter("load_controller"), "load controller"),
    ]


def _contacts(root: etree._Element) -> list[str]:
    """Contact other than sliding-elastic in one pass with a rigid secondary side."""
    rigid = {
        each.get("name") for each in root.iterfind("Material/material") if each.get("type") == "rigid body"
    }
    parts = {
        each.get("name") for each in _elements(*root.iterfind("MeshDomains")) if each.get("mat") in rigid
    }
    nodes = {
        node.strip()
        for each in root.iterfind("Mesh/Elements")
        if each.get("name") in parts
        for cell in each
        for node in (cell.text or "").split(",")
    }
    why = []
    for each in root.iter("contact"):
        if each.get("type") != "sliding-elastic":
            why.append(f"contact {each.get('type')}")
            continue
        if (each.findtext("two_pass") or "0").strip() not in ("0", "false"):
            why.append("contact in two passes")
        pair = root.find(f"Mesh/SurfacePair[@name='{each.get('surface_pair')}']")
        secondary = pair.findtext("secondary") if pair is not None else None
        facets = root.find(f"Mesh/Surface[@name='{(secondary or '').strip()}']")
        on = {
            node.strip() for facet in (facets if facets is not None else ()) for node in facet.text.split(",")
        }
        if not on or not on <= nodes:
            why.append("contact of two deformable sides")
    return why


# ---------------------------------------------------------------- runs


@dataclass(frozen=True)
class Row:
    """One file in scope; why: what ended it, if it was not read or did not run."""

    name: str
    gold: float
    read: bool = False
    value: float | None = None
    why: str = ""
    seconds: float = 0.0

    @property
    def error(self) -> float | None:
        if self.value is None:
            return None
        return abs(self.value - self.gold) / max(abs(self.gold), _SMALL)

    @property
    def agrees(self) -> bool:
        return self.error is not None and self.error <= NEAR


class _Late(Exception):
    """The time limit of one file."""


def row_of(path: Path, gold: float, time_limit_s: int) -> Row:
    started, read = time.process_time(), False

    def late(*_: object) -> None:
        raise _Late

    signal.signal(signal.SIGALRM, late)
    signal.alarm(time_limit_s)
    try:
        model = read_feb(path)
        read = True
        analysis = prepare(model, threads=1)
        try:
            value = solution_norm(analysis, analysis.run()[-1])
        finally:
            analysis.close()
        return Row(path.stem, gold, True, value, seconds=time.process_time() - started)
    except LimbError as error:
        why = "; ".join([*map(str, error.facts.get("problems", ()))] or [error.what])  # type: ignore[call-overload]
        return Row(path.stem, gold, read, why=why, seconds=time.process_time() - started)
    except _Late:
        return Row(path.stem, gold, read, why=f"more than {time_limit_s} s")
    finally:
        signal.alarm(0)


def solution_norm(analysis: Analysis, last: Snapshot) -> float:
    """Norm of FEBio's total solution vector at the last state."""
    system = analysis.system
    parts = [last.state.u[system.free]]
    for b, dof in system.rigid:
        now, begin = last.state.bodies[b], system.start.bodies[b]
        turn = whole_rotation(now.rotation, -begin.rotation)
        parts.append(np.atleast_1d(np.concatenate([now.shift - begin.shift, turn])[dof]))
    return float(np.linalg.norm(np.concatenate(parts)))


# ---------------------------------------------------------------- table


def kind_of(why: str) -> str:
    """A reason without what belongs to one file."""
    text = re.sub(r"line \d+: ", "", why.split(";")[0])
    return re.sub(r"'[^']*'|[-+]?\d[\d.e+-]*", "...", text)[:90]


def table(rows: list[Row], outside: Counter[str], n_files: int, n_in_scope: int) -> str:
    run = [each for each in rows if each.value is not None]
    lines = [
        "| | files |", "|-|-|",
        f"| in the suite | {n_files} |",
        f"| in scope | {n_in_scope} |",
        f"| of these tried | {len(rows)} |",
        f"| read | {sum(each.read for each in rows)} |",
        f"| run to the end | {len(run)} |",
        f"| within {NEAR:g} of the suite's value | {sum(each.agrees for each in rows)} |",
        "", "| in scope, but | files | which |", "|-|-|-|",
    ]  # fmt: skip
    others: dict[str, list[str]] = {}
    for each in rows:
        if each.value is None:
            others.setdefault(kind_of(each.why), []).append(each.name)
        elif not each.agrees:
            others.setdefault("another value", []).append(f"{each.name} ({each.error:.1e})")
    for why, names in sorted(others.items(), key=lambda item: -len(item[1])):
        lines.append(f"| {why} | {len(names)} | {', '.join(names)} |")
    lines += ["", "| out of scope (a file may have several reasons) | files |", "|-|-|"]
    lines += [f"| {why} | {n} |" for why, n in outside.most_common()]
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("folder", type=Path, help="a copy of febiosoftware/TestSuite")
    parser.add_argument("--gold", type=Path, help="folder with code/, if it is another one")
    parser.add_argument("--sample", type=int, help="number of files in scope to try, drawn by seed")
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--only", nargs="*", help="names of files in scope to try")
    parser.add_argument("--scope", action="store_true", help="only tell which files are in scope")
    parser.add_argument("--time-limit-s", type=int, default=300, help="of one file")
    parser.add_argument("--out", type=Path, help="rows, one JSON a line")
    arguments = parser.parse_args()
    gold = gold_values(arguments.gold or arguments.folder)
    inside: list[Path] = []
    outside: Counter[str] = Counter()
    files = sorted((arguments.folder / "Verify").glob("*.feb"))
    for path in files:
        lenient = etree.XMLParser(recover=True, huge_tree=True, remove_comments=True)
        why = out_of_scope(etree.parse(path, lenient).getroot())
        if not why and path.stem not in gold:
            why = ["without a value in the suite"]
        outside.update(why)
        if not why:
            inside.append(path)
    chosen = [each for each in inside if arguments.only is None or each.stem in arguments.only]
    if arguments.sample is not None and arguments.sample < len(chosen):
        rng = np.random.default_rng(arguments.seed)
        chosen = sorted(rng.choice(np.array(chosen, dtype=object), arguments.sample, replace=False))
    if arguments.scope:
        print(" ".join(each.stem for each in inside))
        chosen = []
    jobs = {(each.stem,): each for each in chosen}

    def one(path: Path) -> dict[str, Any]:
        return asdict(row_of(path, gold[path.stem], arguments.time_limit_s))

    rows = made(arguments.out, jobs, one, key=("name",))
    shown = [Row(**row) for row in rows if (row["name"],) in jobs]
    print(table(shown, outside, len(files), len(inside)))


if __name__ == "__main__":
    main()
