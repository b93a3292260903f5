"""The readings of a case's sites: from the diagnosis where it named an effect, else from the fit; and maps.

f_kappa of a diagnosis is not taken: its interval is hardly narrower than its prior. What a force says of c,
m and f_kappa together is a reading of its own (`site_force`). A fit knows m by that alone, a diagnosis by
wave speeds too, so that its m counts beside the force of its tissue.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from limbcli.case import Case, Site
from limbcli.effects import EFFECTS
from limbcli.errors import FitError, MeasurementError
from limbcli.errors.problems import raise_errors
from limbcli.measurement.elastography import check_width, map_file, read_map
from limbcli.measurement.indentation import Levels
from limbcli.measurement.map_noise import PixelNoise, pixel_noise
from limbcli.model import Array
from limbcli.numbers.units import mpa_from_kpa
from limbcli.provenance.staleness import Chain
from limbcli.results import UNLIKE_OURS, StageResult, StageWriter
from limbcli.site_model.site_levels import levels_of, maps_of
from limbcli.stages.limb_field.site_force import KEYS as OF_FORCE
from limbcli.stages.limb_field.site_force import force_reading
from limbcli.stiffness_field import Interval, MapReading, SiteReading, map_reading, region_below

_KEYS = {"c_kpa": "c", "m": "m", "f_kappa": "f_kappa"}
_OF_FIT = (*_KEYS, "interval_95", "correlation", *OF_FORCE)  # what the readings are made from
_OF_DIAGNOSIS = ("added", "shrink", "tissue_force")
_MISREAD = {each.name for each in EFFECTS if each.kind == "swe"}  # effects by which speeds are misread
_MOST_CORRELATED = 0.98
_DEEP_MM = 30.0  # region of a site without bone below it


@dataclass(frozen=True)
class LimbReadings:
    """All that the results say of the sites.

    left_out : by site, why it gave nothing (or not its map)
    """

    sites: list[SiteReading] = field(default_factory=list)
    maps: list[MapReading] = field(default_factory=list)
    left_out: dict[str, str] = field(default_factory=dict)


def site_results(case: Case, chain: Chain, writer: StageWriter) -> LimbReadings:
    """The readings of all sites that were meshed, and fitted or diagnosed or have a map at rest.

    writer : records the results used

    Raises CaseError if a result is out of date; MeasurementError if a map is faulty; FitError if a result
    lacks what every version writes.
    """
    found = LimbReadings()
    for site in case.sites:
        mesh = chain.present("mesh", site=site.name)
        if mesh is None:
            found.left_out[site.name] = "it is not meshed"
            writer.without_result("mesh", site.name)
            continue
        try:
            _add(found, site, mesh, chain, writer)
        except UNLIKE_OURS as error:
            raise FitError(
                f"the results of site {site.name} lack a value ({type(error).__name__}: {error})",
                where=f"site {site.name}",
                fix=f"fit it again: `limbcli fit CASE --site {site.name}`",
            ) from error
    return found


def _add(found: LimbReadings, site: Site, mesh: StageResult, chain: Chain, writer: StageWriter) -> None:
    fit, diagnosis = (chain.present(stage, site=site.name) for stage in ("fit", "diagnose"))
    for stage, result in (("fit", fit), ("diagnose", diagnosis)):
        if result is None:
            writer.without_result(stage, site.name)
    added = list(diagnosis.data["added"]) if diagnosis is not None else []
    used = diagnosis if diagnosis is not None and (added or fit is None) else fit
    if used is not None:
        values, correlation, source = of_diagnosis(used.data) if used is diagnosis else of_fit(used.data)
        c_kpa, beside = (
            (used.data["c_kpa"], ("c",)) if used is fit
            else (used.data["shrink"][-1]["values"]["c_kpa"], ("c", "m"))
        )  # fmt: skip
        force = force_reading(used.data, c_kpa=float(c_kpa))
        found.sites.append(
            SiteReading(site.name, region_of_site(mesh), values, correlation, source, force, beside)
        )
        writer.used_result(used, data=_OF_FIT if used is fit else _OF_DIAGNOSIS)
        writer.used_result(mesh, data=["frame", "checks/skin_bone_mm"])
    if site.swe_maps is not None:
        misread = [name for name in added if name in _MISREAD]
        if misread:
            found.left_out[f"map of {site.name}"] = f"its diagnosis named {', '.join(misread)}"
        elif isinstance(read := _map_at_rest(site, mesh, writer, has_c=used is not None), str):
            found.left_out[f"map of {site.name}"] = read
        else:
            found.maps.append(read)
    elif used is None:
        found.left_out[site.name] = "it is neither fitted nor diagnosed, and has no maps"


def region_of_site(mesh: StageResult) -> Array:
    """Points (n, 3), mm, patient LPS, of the tissue over which a meshed site averages."""
    frame = mesh.data["frame"]
    return region_below(
        np.array(frame["skin_point_mm"], float), np.array(frame["normal"], float),
        np.array(frame["long_axis"], float), length=site_length(mesh),
        skin_bone=float(mesh.data["checks"].get("skin_bone_mm") or _DEEP_MM),
    )  # fmt: skip


def site_length(mesh: StageResult) -> float:
    """Length of the probe's face (mm) with which a site was meshed."""
    return float(mesh.provenance["made_from"]["case"]["probe"]["length"])


Reading = tuple[dict[str, Interval], dict[tuple[str, str], float], str]


def of_fit(data: Mapping[str, Any]) -> Reading:
    """c, m and f_kappa of fit.json with their intervals; correlations of their errors; source in words."""
    intervals = data["interval_95"]
    values = {
        name: _interval(key, float(data[key]), *(intervals.get(key) or (None, None)))
        for key, name in _KEYS.items()
    }
    rho = data.get("correlation") or {}
    pairs = {("c", "f_kappa"): "c,f_kappa", ("c", "m"): "c,m", ("m", "f_kappa"): "f_kappa,m"}
    # A correlation of 1 would make two readings one.
    correlation = {
        pair: _MOST_CORRELATED * float(rho[key]) for pair, key in pairs.items() if rho.get(key) is not None
    }
    return values, correlation, "fit"


def of_diagnosis(data: Mapping[str, Any]) -> Reading:
    """c and m of a diagnosis with all that it added, as averaged over its explanations."""
    last = data["shrink"][-1]
    values = {
        _KEYS[key]: _interval(key, float(last["values"][key]), *last["intervals_95"][key])
        for key in ("c_kpa", "m")
    }
    named = ", ".join(data["added"]) or "nothing missing"
    return values, {}, f"diagnose ({named})"


def _interval(key: str, value: float, low: float | None, high: float | None) -> Interval:
    if key != "c_kpa":
        return Interval(value, low, high)
    ends = [None if each is None else mpa_from_kpa(float(each)) for each in (low, high)]
    return Interval(mpa_from_kpa(value), *ends)


def _map_at_rest(site: Site, mesh: StageResult, writer: StageWriter, *, has_c: bool) -> MapReading | str:
    """The map of level 0, or why there is none.

    Where the site's c is known it comes from the same speeds, so that the map says only how c varies.
    """
    levels: Levels = levels_of(site)
    if not levels.begins_at_zero:
        return "its first level is not at rest"
    assert site.swe_maps is not None
    path = map_file(site.swe_maps, int(levels.rows[0]))
    if not path.is_file():
        return f"there is no {path.name}"
    swe = read_map(path)
    if not len(swe):
        return f"{path.name} has no pixels"
    raise_errors(check_width(swe, site_length(mesh)), MeasurementError)
    writer.used(f"swe_map {site.name}", path)
    noise = pixel_noise(maps_of(site, levels) or [], usual=site.noise.swe_pixel_fraction)
    noise = PixelNoise(max(noise.deviation, site.noise.swe_pixel_fraction), noise.smoothing, noise.share)
    return map_reading(
        site.name, swe, np.array(mesh.data["frame"]["patient_from_model"], float), noise,
        gain_deviation=None if has_c else 2.0 * site.noise.swe_level_fraction,
        density_kg_per_m3=site.density_kg_per_m3,
    )  # fmt: skip
