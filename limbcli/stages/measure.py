"""measure: turn the instruments' files into the rows of levels.csv.

The load cell's record gives the force of every hold, the B-mode images the reduction of the
skin-bone distance, the colour overlays the shear-wave speeds. Quantities whose instrument is not
named in case.toml are taken from an existing levels.csv or left empty.
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from limbcli.case import Case, Site
from limbcli.errors import CaseError, MeasurementError
from limbcli.errors.problems import Problem, raise_errors
from limbcli.files.atomic import atomic_file, atomic_folder
from limbcli.measurement.bmode import BoneLine, follow_bone
from limbcli.measurement.indentation import (
    OPTIONAL,
    REQUIRED,
    TEXTS,
    Levels,
    check_levels,
    check_values,
    level_warnings,
    read_levels,
)
from limbcli.progress import SILENT, Progress
from limbcli.provenance.chain_inputs import noted
from limbcli.results import StageResult, StageWriter, open_stage
from limbcli.site_model.site_levels import layer_noise
from limbcli.stages.measuring.holds import Columns, column_problems, force_columns
from limbcli.stages.measuring.images import box_of, images_of, measured_speeds, scale_warnings, tissue_between
from limbcli.stages.measuring.layers_on_images import layer_columns, read_borders, write_pennation

STAGE = "measure"


def measure(
    case: Case, *, out: Path, sites: list[str] | None = None, write: bool = False, progress: Progress = SILENT
) -> list[StageResult]:
    """Read the instruments' files of each site; with `write`, write levels.csv where the case names it.

    Raises as `limbcli.measure`.
    """
    results = []
    for site in case.selected(sites):
        if not site.instruments:
            raise CaseError(
                f"site {site.name} specifies no instrument file",
                where=str(case.file),
                fix='add trace = "trace.csv", [site.load_cell], [site.b_mode] or [site.swe_images], or write '
                "levels.csv by hand",
            )
        progress.event("stage", name=STAGE, site=site.name)
        with open_stage(out, STAGE, subject=case.subject, site=site.name) as writer:
            rows = _measure_site(noted(case, writer), site.name, out, writer, progress)
            if write and "swe_images" in site.instruments and site.swe_maps and site.swe_maps.exists():
                writer.warnings.append(
                    f"the maps in {site.swe_maps.name} already existed and are kept: to "
                    "use the new ones, copy them there from the output folder (swe)"
                )
        if write:
            _write_levels(site, rows, writer.result)
            _write_maps(site, writer.result)
        results.append(writer.result)
    return results


def _measure_site(case: Case, name: str, out: Path, writer: StageWriter, progress: Progress) -> str:
    site = case.site(name)
    instruments = site.instruments
    known = read_levels(site.levels) if site.levels.is_file() else None
    columns: Columns = {}
    if "load_cell" in instruments:
        columns |= force_columns(instruments["load_cell"], writer)
        progress.event("note", text=f"{len(columns['force_n'])} holds found")
    elif known is not None:
        columns |= _of_known(known, instruments)
    if "b_mode" in instruments:
        depths = _depth(instruments["b_mode"], writer, progress)
        raise_errors(_impossible(depths, instruments["b_mode"]["path"]), MeasurementError)
        columns |= depths
    if "swe_images" in instruments:
        tissue = tissue_between(case, site, out, columns.get("skin_bone_mm"), writer)
        columns |= measured_speeds(instruments["swe_images"], tissue, writer, progress)
    _check_lengths(columns, site)
    place = instruments["load_cell"]["path"] if "load_cell" in instruments else site.levels
    raise_errors(column_problems(columns, site=site.name, place=place), MeasurementError)
    _check_agreement(columns, known, writer)
    text = _as_csv(columns)
    path = writer.file("levels", "levels.csv")
    path.write_text(text, encoding="utf-8")
    if {"force_n", "depth_mm"} <= set(columns):
        # Reject here what a later stage would reject.
        problems = check_levels(path, noise=layer_noise(site))[1]
        found = [replace(each, where=f"the levels of site {site.name}") for each in problems]
        raise_errors(found, MeasurementError)
        writer.warnings.extend(level_warnings(path, noise=layer_noise(site)))
    writer.data["n_levels"] = len(next(iter(columns.values())))
    writer.summary.append(f"{writer.data['n_levels']} levels: {', '.join(columns)}")
    return text


def _of_known(known: Levels, instruments: Mapping[str, Any]) -> Columns:
    """The columns of an existing levels.csv except those read by the instruments."""
    columns: Columns = {"force_n": list(known.force), "depth_mm": list(known.depth)}
    if known.cycles != (1,) or not known.loading.all():
        columns |= {"cycle": known.cycle.tolist(), "phase": list(known.phase)}
    others = {"hold_s": known.hold, "probe_travel_mm": known.probe_travel}
    if "swe_images" not in instruments:
        others |= {
            "swe_mean_m_per_s": known.swe_mean_m_per_s,
            "swe_sd_m_per_s": known.swe_sd_m_per_s,
            "swe_pixels": known.swe_pixels,
        }
    if "b_mode" not in instruments:
        others |= {"skin_bone_mm": known.skin_bone}
        others |= {f"{name}_mm": values for name, values in known.layers.items()}
    return columns | {name: list(values) for name, values in others.items() if np.isfinite(values).any()}


def _depth(table: Mapping[str, Any], writer: StageWriter, progress: Progress) -> dict[str, Sequence[float]]:
    from limbcli.measurement.instrument_pictures import draw_bone_lines

    images = images_of(table, box_pixels=box_of(table["box_pixels"]))
    writer.warnings.extend(scale_warnings(images, table["mm_per_pixel"]))
    if table["box_pixels"] is None and images[0].is_whole:
        writer.warnings.append(
            "the top of the B-mode images is taken as the probe face: if a frame or text is above it, state "
            "where the ultrasound image lies with box_pixels of [site.b_mode]; the distances to bone and "
            "layers depend on it, the depth of indentation does not"
        )
    lines: list[BoneLine] = follow_bone(images, bone=table["bone_mm"])
    progress.event("task", name="B-mode images", done=len(images), total=len(images))
    borders = read_borders(images, table, lines, writer)
    write_pennation(images[0], borders, lines[0], writer)
    draw_bone_lines(images, lines, writer.file("bone_picture", "bone.png"), borders=borders)
    writer.data["bone"] = [vars(each) for each in lines]
    worst = max(each.sd for each in lines)
    span = f"{lines[0].distance:.2f} to {lines[-1].distance:.2f} mm"
    writer.summary.append(f"skin-bone distance {span}, SD at most {worst:.2f} mm")
    return {
        "skin_bone_mm": [each.distance for each in lines],
        "depth_mm": [lines[0].distance - each.distance for each in lines],
        **layer_columns(borders, lines),
    }


def _impossible(columns: Mapping[str, Sequence[Any]], folder: Path) -> list[Problem]:
    """Impossible values of what was followed on B-mode images."""
    fix = "what was followed is not the bone: state bone_mm as a list, its depth in every image; or the "
    fix += "names of the images are not in the order measured"
    return [replace(each, fix=fix) for each in check_values(columns, folder)]


def _check_lengths(columns: Mapping[str, Sequence[Any]], site: Site) -> None:
    counts = {name: len(values) for name, values in columns.items()}
    if len(set(counts.values())) > 1:
        listed = ", ".join(f"{name} {count}" for name, count in counts.items())
        raise MeasurementError(
            f"the instruments have different numbers of levels: {listed}",
            where=f"site {site.name}",
            fix="give one image per hold; change hold_s or hold_tolerance_n; remove surplus images",
            **counts,
        )


def _check_agreement(columns: Mapping[str, Sequence[Any]], known: Levels | None, writer: StageWriter) -> None:
    """Compare the readings with an existing levels.csv (which may have been read by hand)."""
    if known is None or len(known) != len(next(iter(columns.values()))):
        return
    for name, values, tolerance in (("force_n", known.force, 0.2), ("depth_mm", known.depth, 0.5)):
        if name in columns:
            worst = float(np.abs(np.asarray(columns[name]) - values).max())
            writer.data[f"largest_difference_{name}"] = worst
            if worst > tolerance:
                writer.warnings.append(f"{name} differs from the existing levels.csv by up to {worst:.2f}")


def _as_csv(columns: Mapping[str, Sequence[Any]]) -> str:
    names = [name for name in dict.fromkeys(("cycle", *TEXTS, *REQUIRED, *OPTIONAL)) if name in columns]
    lines = [",".join(names)]
    for k in range(len(columns[names[0]])):
        cells = (columns[name][k] for name in names)
        lines.append(",".join(map(_as_cell, cells)))
    return "\n".join(lines) + "\n"


def _as_cell(value: str | float) -> str:
    """Text of a cell; empty if there is no reading."""
    if isinstance(value, str):
        return value
    return f"{value:.6g}" if np.isfinite(value) else ""


def _write_maps(site: Site, result: StageResult) -> None:
    """Write the decoded maps to the folder that case.toml names, unless it exists."""
    if site.swe_maps is None or site.swe_maps.exists() or not (result.folder / "swe").is_dir():
        return
    with atomic_folder(site.swe_maps, is_new=True) as folder:
        for each in sorted((result.folder / "swe").glob("level_*.csv")):
            shutil.copy2(each, folder / each.name)


def _write_levels(site: Site, text: str, result: StageResult) -> None:
    lacking = [each for each in ("force_n", "depth_mm") if each not in text.splitlines()[0].split(",")]
    if lacking:
        raise MeasurementError(
            f"no levels.csv was written: the instruments gave no {' and no '.join(lacking)}",
            where=f"site {site.name}",
            fix="add [site.load_cell] and [site.b_mode], or enter these columns manually; "
            "the readings are in the output folder",
        )
    if site.levels.exists():
        raise CaseError(
            "levels.csv already exists and is not overwritten",
            where=str(site.levels),
            fix=f"to use the new one, copy it there: {result.path('levels')}",
        )
    with atomic_file(site.levels) as path:
        path.write_text(text, encoding="utf-8")
