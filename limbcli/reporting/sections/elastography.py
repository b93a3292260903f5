"""Does the tissue stiffen with load, as shear waves see it?"""

from __future__ import annotations

from limbcli.measurement.regression import Line
from limbcli.reporting.figures.wave_speed import line_words, wave_speed
from limbcli.reporting.numbers import DASH, cell
from limbcli.reporting.page import Page, SiteMaterial
from limbcli.reporting.reportlet import Cell, Picture, Reportlet, Table, head

TITLE = "Does the tissue stiffen with load, as shear waves see it?"


def elastography(page: Page, site: SiteMaterial) -> Reportlet:
    """Speed against force with its line and R2, and against depth."""
    key = f"elastography-{site.name}"
    if site.speeds is None:
        why = site.why_no_levels or "The levels of this site have no shear-wave speeds."
        return Reportlet(key, TITLE, "missing", site.name, notes=(why,))
    lines = (("force", "N", site.against_force), ("depth", "mm", site.against_depth))
    rows = tuple(_row(name, unit, line, site.why_no_line) for name, unit, line in lines)
    names = head("speed against", "slope", "standard error", "speed at zero [m/s]", "R² [–]", "levels")
    words = [line_words(line, unit) for _, unit, line in lines[:1] if line]
    alt = f"Shear-wave speed over probe force and over depth at site {site.name}. "
    figure = wave_speed(site.speeds, against_force=site.against_force, against_depth=site.against_depth)
    return Reportlet(
        key,
        TITLE,
        "fine" if site.against_force else "warning",
        site.name,
        pictures=(Picture(f"wave-speed-{site.name}", alt + "".join(words), figure=figure),),
        tables=(Table(f"Straight lines through the speeds at site {site.name}", (names,), rows),),
        look_for="speeds that rise steadily with load; the speed at zero load gives the initial stiffness "
        "c. Against depth the picture hardly depends on the force zero, on skin or on the mesh",
        bad="a step or scatter larger than the bars, a speed that falls under load, or bars so tall that "
        "the first level could mean half or double the stiffness (c goes with the square of the speed)",
        warned=(site.why_no_line,) if site.why_no_line else (),
    )


def _row(name: str, unit: str, line: Line | None, why: str) -> tuple[Cell, ...]:
    if line is None:
        return (Cell(name, lead=True), *[Cell(DASH, reason=why) for _ in range(5)])
    per = f"m/s per {unit}"
    return (
        Cell(name, lead=True),
        cell(line.slope, unit=per),
        cell(line.slope_se, unit=per, digits=2, reason="needs three levels"),
        cell(line.intercept),
        cell(line.r2, digits=4, reason="the speed does not vary"),
        Cell(str(line.n) if line.n else DASH),
    )
