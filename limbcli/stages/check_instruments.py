"""check: measured layers, and problems in the instruments' files at which `limbcli measure` would stop."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from limbcli.case import Case, Site, StatedNoise
from limbcli.errors import LimbError
from limbcli.errors.problems import Problem

if TYPE_CHECKING:
    from limbcli.measurement.holds import Hold
    from limbcli.measurement.indentation import LayerNoise, Levels


def instrument_problems(case: Case) -> list[Problem]:
    """Records and images that cannot be read, or whose numbers of levels differ.

    If levels.csv exists already they are not needed, and the problems are only warnings.
    """
    return [problem for site in case.sites for problem in _of_site(site, str(case.file))]


def _of_site(site: Site, file: str) -> list[Problem]:
    severity: Any = "warning" if site.levels.is_file() else "error"
    counts: dict[str, int] = {}
    found = []
    for kind, table in site.instruments.items():
        if severity == "warning" and table["path"] == site.trace:
            continue  # a trace that accompanies levels.csv is checked as a trace
        try:
            levels = _levels(kind, table)
            counts[kind] = len(levels)
            if kind == "load_cell":
                found += _of_holds(levels, table, site.name, severity)
        except LimbError as error:
            found.append(Problem(error.what, error.where, error.fix, severity, "measurement"))
    if len(set(counts.values())) > 1:
        listed = ", ".join(f"{kind} {n}" for kind, n in counts.items())
        fix = "give one image per hold; change hold_s or hold_tolerance_n; remove surplus images"
        what = f"the instruments of site {site.name} have different numbers of levels: {listed}"
        found.append(Problem(what, file, fix, severity, "measurement"))
    return found


def _of_holds(holds: Sequence[Hold], table: Any, site: str, severity: Any) -> list[Problem]:
    """Impossible values among a record's holds."""
    from limbcli.stages.measuring.holds import column_problems, columns_of

    columns = columns_of(holds, float(table["step_n"]))
    problems = column_problems(columns, site=site, place=table["path"])
    return [replace(each, severity=severity) for each in problems]


def _levels(kind: str, table: Any) -> Sequence[Any]:
    """The holds of a record, or the images of a folder. Raises as `limbcli measure`."""
    from limbcli.stages.measuring.holds import holds_of
    from limbcli.stages.measuring.images import box_of, images_of

    if kind == "load_cell":
        return holds_of(table)[1]
    return images_of(table, box_pixels=box_of(table["box_pixels" if kind == "b_mode" else "image_pixels"]))


def stated_layer_noise(site: Mapping[str, Any]) -> LayerNoise:
    """Noise of layers, depth and speeds of a site's raw table in case.toml; default values where it states
    no usable ones."""
    from limbcli.measurement.indentation import LayerNoise
    from limbcli.measurement.speed_noise import SpeedNoise

    table, usual = site.get("noise"), StatedNoise()
    table = table if isinstance(table, Mapping) else {}
    numbers = {
        "layer_mm": usual.layer, "depth_mm": usual.depth,
        "swe_level_fraction": usual.swe_level_fraction, "swe_pixel_fraction": usual.swe_pixel_fraction,
    }  # fmt: skip
    found = {key: table.get(key, value) for key, value in numbers.items()}
    if not all(isinstance(each, int | float) for each in found.values()):
        return LayerNoise()
    thickness, depth, level, pixel = found.values()
    return LayerNoise(thickness, depth, SpeedNoise(level, pixel))


def layer_lines(case: Case) -> list[str]:
    """One line for each site that has layers.

    Unreadable files are skipped, as they have been reported already.
    """
    from limbcli.measurement.indentation import check_levels

    lines = []
    for site in case.sites:
        levels = check_levels(site.levels)[0] if site.levels.is_file() else None
        if levels is not None and levels.layers:
            lines.append(f"site {site.name}: {layer_words(levels)}")
    return lines


def layer_words(levels: Levels) -> str:
    """Each layer's thickness (mm) at the first and last loading level at which it was read.

    >>> from types import SimpleNamespace
    >>> some = SimpleNamespace(
    ...     layers={"skin": np.array([1.5, 1.4, np.nan]), "fat": np.array([6.0, 4.9, 4.1])},
    ...     loading=np.ones(3, dtype=bool), force=np.array([0.0, 4.0, 8.0]),
    ... )
    >>> layer_words(some)
    'skin 1.5 to 1.4 mm (0 to 4 N), fat 6 to 4.1 mm (0 to 8 N)'
    """
    parts = []
    for name, values in levels.layers.items():
        seen = np.flatnonzero(np.isfinite(values) & levels.loading)
        if not len(seen):
            continue
        first, last = seen[0], seen[-1]
        forces = f"{levels.force[first]:.3g} to {levels.force[last]:.3g} N"
        parts.append(f"{name} {values[first]:.3g} to {values[last]:.3g} mm ({forces})")
    return ", ".join(parts)
