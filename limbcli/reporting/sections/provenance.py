"""How this page was made: commands, versions, solvers, inputs, units."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from limbcli.reporting.numbers import DASH, quantity
from limbcli.reporting.outcome import Outcome
from limbcli.reporting.report_data import ReportData
from limbcli.reporting.reportlet import Cell, PageTable, Reportlet, table

KEY, TITLE = "provenance", "How was this page made?"


def provenance(page: ReportData, own: Mapping[str, Any]) -> Reportlet:
    """Commands, solvers, versions and input hashes of all stages, and of this page (`own`)."""
    done = page.outcomes.done
    units = f"Unit system inside: {own['units']}; every other unit is given with its number."
    return Reportlet(
        KEY,
        TITLE,
        tables=(_commands(done, own), _solvers(done)),
        more=(_inputs(done, own), _versions(done, own)),
        look_for="the same version everywhere, and input hashes that match the files at hand",
        bad="a stage made by another version or from other inputs than the rest: run it again",
        notes=(units,),
    )


def _commands(done: tuple[Outcome, ...], own: Mapping[str, Any]) -> PageTable:
    rows = [
        (
            label, made["command"], made["limbcli"], made["finished_utc"].replace("T", " ").removesuffix("Z"),
            quantity(made.get("seconds"), "s", digits=2, reason="not yet finished"),
        )
        for label, made in _made(done, own)
    ]  # fmt: skip
    names = ("stage", "command", "limbcli", "finished (UTC)", "took")
    return table("Commands", names, rows, numeric=False)


def _made(done: tuple[Outcome, ...], own: Mapping[str, Any]) -> list[tuple[str, Mapping[str, Any]]]:
    return [(each.label, each.result.provenance) for each in done if each.result] + [("report", own)]


def _solvers(done: tuple[Outcome, ...]) -> PageTable:
    rows: list[tuple[Cell | str, ...]] = []
    for each in done:
        if each.result is None or each.stage not in ("run", "fit", "fit-joint", "fit-states"):
            continue
        facts = {**each.result.provenance, **each.result.data}
        solver = facts.get("solver")
        if isinstance(solver, Mapping):
            facts, solver = {**facts, **solver, "solver_version": solver.get("version")}, solver.get("name")
        rows.append(
            (
                each.label,
                _cell_or_why(solver, "not in the result"),
                _cell_or_why(facts.get("solver_version"), "not reported by the solver"),
                _cell_or_why(facts.get("linear_solver"), "not reported by the solver"),
            )
        )
    names = ("stage", "solver that ran", "version", "linear solver")
    if not rows:
        rows = [(Cell(DASH, lead=True, reason="no simulation has been run"), *[Cell(DASH)] * 3)]
    return table("Solver", names, rows, numeric=False)


def _cell_or_why(value: object, why_not: str) -> Cell:
    return Cell(str(value)) if value else Cell(DASH, reason=why_not)


def _inputs(done: tuple[Outcome, ...], own: Mapping[str, Any]) -> PageTable:
    rows = [(label, *each) for label, made in _made(done, own) for each in made["inputs_sha256"].items()]
    return table("Inputs", ("stage", "input", "SHA-256"), rows, numeric=False)


def _versions(done: tuple[Outcome, ...], own: Mapping[str, Any]) -> PageTable:
    versions: dict[str, dict[str, None]] = {}
    for _, made in _made(done, own):
        used = {"python": made["python"], "platform": made["platform"], **made["packages"]}
        for name, version in used.items():
            versions.setdefault(name, {})[version] = None
    rows = ((name, ", ".join(found)) for name, found in versions.items())
    return table("Versions", ("package", "version"), rows, numeric=False)
