"""Is the response repeatable over loading cycles?"""

from __future__ import annotations

from limbcli.reporting.figures.hysteresis_loops import Loop, cycles
from limbcli.reporting.numbers import DASH
from limbcli.reporting.report_data import ReportData, SiteMaterial
from limbcli.reporting.reportlet import Cell, PageTable, Picture, Reportlet, table

TITLE = "Is the response repeatable over loading cycles?"


def repeated_loading(page: ReportData, site: SiteMaterial) -> Reportlet | None:
    """Loops, energy loss by cycle, and when the response becomes repeatable; None if there is only one
    loading."""
    found = site.cycles
    if found is None:
        return None
    key = f"cycles-{site.name}"
    outcome = page.outcomes.of("fit", site.name)
    cycle = outcome.result.data.get("cycle") if outcome.result is not None else None
    warned = (found.contradiction,) if found.contradiction else ()
    notes = [*found.sentences]
    if isinstance(cycle, dict) and "fitted" in cycle:
        notes.append(f"The parameters on this page are of cycle {cycle['fitted']}.")
    return Reportlet(
        key,
        TITLE,
        "warning" if warned or not found.settled else "fine",
        site.name,
        pictures=(Picture(key, _alt(site.name, found.loops), figure=cycles(found.loops)),),
        tables=(_table(found.loops),),
        look_for="loops that coincide from some cycle on, with the same energy loss each time: from "
        "there on the tissue is preconditioned and its curve is repeatable",
        bad="a last loop that still shifts, or a fit to a cycle that later ones do not "
        "repeat: its parameters describe a transient state",
        notes=tuple(notes),
        warned=warned,
    )


def _table(loops: tuple[Loop, ...]) -> PageTable:
    rows = (
        (
            str(each.number),
            Cell(f"{each.loading[1].max():.1f}") if len(each.loading[1]) else _none("no loading was read"),
            Cell(f"{each.loading[0][0]:.2f}") if len(each.loading[0]) else _none("no loading was read"),
            _none("no unloading was read")
            if each.lost is None
            else Cell(f"{_tenths(each.lost)} ± {each.lost_deviation:.1f}"),
            _none("no unloading was read")
            if each.lost_fraction is None
            else Cell(f"{100 * each.lost_fraction:.0f}"),
        )
        for each in loops
    )
    names = (
        "cycle", "largest force [N]", "depth at its start [mm]", "energy lost [N mm]", "of the work [%]",
    )  # fmt: skip
    return table("Loading cycles (± one standard deviation from the stated noise)", names, rows)


def _none(reason: str) -> Cell:
    return Cell(DASH, reason=reason)


def _tenths(energy: float) -> str:
    """Energy in N mm, as text for the alternative text and the table.

    >>> _tenths(0.62), _tenths(-0.04)
    ('0.6', '0.0')
    """
    return f"{round(energy, 1) + 0.0:.1f}"


def _alt(name: str, loops: tuple[Loop, ...]) -> str:
    losses = ", ".join(_tenths(each.lost) for each in loops if each.lost is not None)
    text = f"Force over depth of {len(loops)} loading cycle{'s' if len(loops) > 1 else ''} at site {name}"
    return text + (f"; energy lost in each: {losses} N mm." if losses else ".")
