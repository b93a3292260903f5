"""What depth and shear waves show together, and which law best predicts held-out data."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from limbcli.reporting.agreement_view import agreement_view
from limbcli.reporting.fit_view import read_estimates
from limbcli.reporting.numbers import DASH, cell, quantity
from limbcli.reporting.report_data import ReportData
from limbcli.reporting.reportlet import Cell, PageTable, Picture, Reportlet, pictures_of, table, worst_mood
from limbcli.reporting.sections.model_checks import model_check_tables
from limbcli.reporting.sections.of_stage import of_stage
from limbcli.reporting.sections.parameters import estimates_table
from limbcli.results import StageResult


@of_stage("fit-joint", "fit-joint", "What do depth and shear waves show together?")
def joint(result: StageResult, _: ReportData) -> Reportlet:
    """Parameters, curves and profiles of the joint fit."""
    data = result.data
    estimates = read_estimates(data.get("parameters", {}), data.get("element"))
    sites = ", ".join(map(str, data.get("sites", [])))
    law = data.get("law_words") or data.get("law") or DASH
    met, sound = agreement_view(data), all(each.is_sound for each in estimates)
    return Reportlet(
        mood=worst_mood(met.mood, "fine" if sound and not result.warnings else "warning"),
        pictures=_pictures(result, sites),
        tables=(estimates_table(f"Joint fit of {sites}: {law}; c is free", estimates), *_checks(data)),
        look_for="curves through the points of both columns, chi-square near its degrees of freedom, and "
        "a c that agrees with the shear-wave reading at zero load: one tissue explains both",
        bad="a fit that follows one column and misses the other, or parameters that leave the intervals of "
        "the fit to the force alone: then the model cannot fit both",
        notes=tuple(_notes(data)),
        warned=result.warnings,
        answer=met.sentence,
    )


def _pictures(result: StageResult, sites: str) -> tuple[Picture, ...]:
    curves = f"Force over depth and shear-wave speed over force at {sites}, with the joint fit."
    ends = "Joint profile likelihood over c and the law's other parameters."
    return pictures_of(result, {"picture": ("joint-curves", curves), "profiles": ("joint-profiles", ends)})


def _checks(data: Mapping[str, Any]) -> list[PageTable]:
    """What other boundaries and a stiffer contact change, site by site."""
    keys = ("boundary_check", "contact_check")
    by_site = {
        site: {key: (data.get(key) or {}).get(site) for key in keys} for site in data.get("sites") or ()
    }
    return [table for site, found in by_site.items() for table in model_check_tables(str(site), found)]


def _notes(data: Mapping[str, Any]) -> list[str]:
    notes = [
        "Fitted to the depths at the measured forces and the logarithms of all levels' speeds, each weighted "
        f"by its stated noise: chi-square {quantity(data.get('chi_square'), '')} for "
        f"{data.get('n_freedom', DASH)} degrees of freedom."
    ]
    if data.get("mu_along_kpa") is not None:
        notes.append(
            f"The shear modulus across the fibres is {quantity(data.get('mu_across_kpa'), 'kPa')}, along "
            f"them {quantity(data.get('mu_along_kpa'), 'kPa')}."
        )
    for name, each in (data.get("orientations") or {}).items():
        notes.append(
            f"Site {name}: the image lies {quantity(each.get('fibre_to_image_deg'), '°', digits=2)} from the "
            f"fibres" + ("." if each.get("fibres_told") else ", whose direction was not stated.")
        )
    for name, each in (data.get("direction_uncertainty") or {}).items():
        force, speed = (100 * each[f"{key}_change_fraction"] for key in ("force", "speed"))
        notes.append(
            f"Site {name}: fibres one deviation ({each['deviation_deg']:.1f}°) further out of the skin "
            f"change the force by up to {force:+.1f} %, the speeds by up to {speed:+.1f} %; the intervals "
            "do not include this."
        )
    gains, deviations = data.get("gains") or {}, data.get("gain_deviations") or {}
    notes += [
        f"Site {site}: the simulated force was multiplied by {quantity(gain, '')} "
        f"(error of mesh and boundaries allowed: {quantity(100 * deviations[site], '%', digits=2)})."
        for site, gain in gains.items()
        if site in deviations
    ]
    return notes


@of_stage("fit-joint", "laws", "Which law predicts held-out levels best?", silent=True)
def laws(result: StageResult, _: ReportData) -> Reportlet | None:
    """The laws by their error on held-out levels; None if they were not compared, or a later run failed."""
    if not result.data.get("laws"):
        return None
    names = (
        "law", "parameters", "held-out depth [mm]", "held-out speed [%]", "chi-square", "c [kPa]",
        "its shape",
    )  # fmt: skip
    caption = "Laws, best first, by the root-mean-square error of held-out levels"
    return Reportlet(
        tables=(table(caption, names, map(_law_row, result.data["laws"])),),
        look_for="a law that is better by more than the noise of the depth; among equally good laws the one "
        "with fewer parameters",
        bad="laws compared by R²: it is near 1 for any rising curve. Where all laws are off by "
        "the same amount, the law is not the cause",
    )


def _law_row(row: Mapping[str, Any]) -> tuple[Cell, ...]:
    speed = row.get("held_out_speed_fraction")
    shape = "; ".join(f"{name} {quantity(value, '')}" for name, value in (row.get("shape") or {}).items())
    return (
        Cell(str(row.get("law", DASH)), lead=True),
        cell(row.get("n_parameters"), digits=1),
        cell(row.get("held_out_depth_mm")),
        cell(None if speed is None else 100 * speed, reason="this law's speed is not predicted"),
        cell(row.get("chi_square")),
        cell(row.get("c_kpa")),
        Cell(shape),
    )
