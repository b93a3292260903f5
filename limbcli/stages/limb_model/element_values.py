"""The stiffness of every element of a limb's model: of the field through the sites, else one c everywhere."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from limbcli.case import Case
from limbcli.errors import CaseError, MeasurementError
from limbcli.materials.ogden import ogden_type
from limbcli.model import Array, Block, ElementMap, IntArray, LimbModel
from limbcli.numbers.units import kpa_from_mpa, mpa_from_kpa
from limbcli.provenance.staleness import Chain
from limbcli.results import StageResult, StageWriter
from limbcli.site_model.indentation_model import C_KPA, TissueLaw
from limbcli.site_model.site_levels import levels_of
from limbcli.stages.build_feb import tissue_stiffness
from limbcli.stages.limb_field.case_field import CaseField
from limbcli.stiffness_field import LABELS
from limbcli.stiffness_field.draws import Draw

ASSUMED = "assumed"
_SAMPLE = 2000  # elements over which m, f_kappa and draws are averaged
F_KAPPA, M = 100.0, 2.0  # of the law where no site was fitted


@dataclass(frozen=True, eq=False)
class ElementValues:
    """Of each element (n,): c with its 95 % limits (MPa), index into `LABELS`, distance to a site (mm), m and
    f_kappa.

    A distance is NaN where no site gave the value.
    """

    c: Array
    c_low: Array
    c_high: Array
    label: Array
    distance: Array
    m: Array
    f_kappa: Array


def limb_stiffness(case: Case, out: Chain, writer: StageWriter, *, c_kpa: float | None = None) -> TissueLaw:
    """One c for the limb: given, else the mean of the fitted sites, else that of the sites' speeds at rest.

    Raises CaseError if none is known, or the given one is out of range.
    """
    if c_kpa is not None:
        low, high = C_KPA
        if not low <= c_kpa <= high:
            raise CaseError(f"c is {c_kpa:g} kPa", where="--c-kpa", fix=f"give {low:g} to {high:g} kPa")
        return TissueLaw(mpa_from_kpa(c_kpa), F_KAPPA, M, "given with --c-kpa")
    fits = {
        site.name: found for site in case.sites if (found := out.present("fit", site=site.name)) is not None
    }
    if fits:
        return _of_fits(fits, writer)
    speeds = {}
    for site in case.sites:
        try:
            speeds[site.name] = tissue_stiffness(levels_of(site), site)[0]
        except (CaseError, MeasurementError):
            continue
    if not speeds:
        what = (
            "no site is fitted, and none has a shear-wave speed at rest" if case.sites else "there is no site"
        )
        fix = "run `limbcli fit CASE`" if case.sites else "add a [[site]] and fit it"
        raise CaseError(
            f"the limb's stiffness is unknown: {what}", where=case.subject,
            fix=f"{fix}, or give the stiffness by hand: `limb --c-kpa` (`batch` then repeats it)",
        )  # fmt: skip
    words = f"mean of 2 mu from SWE at rest of {_listed(speeds)}"
    return TissueLaw(float(np.mean(list(speeds.values()))), F_KAPPA, M, words, tuple(speeds))


def _of_fits(fits: dict[str, StageResult], writer: StageWriter) -> TissueLaw:
    keys = ("c_kpa", "f_kappa", "m")
    for found in fits.values():
        writer.used_result(found, data=keys)
    table = np.array([[float(each.data[key]) for key in keys] for each in fits.values()])
    c, f_kappa, m = table.mean(axis=0)
    words = f"mean of the fitted {_listed(fits)}"
    return TissueLaw(mpa_from_kpa(float(c)), float(f_kappa), float(m), words, tuple(fits))


def _listed(sites: Sequence[str] | dict[str, object] | dict[str, float] | dict[str, StageResult]) -> str:
    names = list(sites)
    return f"site{'s' if len(names) > 1 else ''} {', '.join(names)}"


def element_values(centroids: Array, stiffness: TissueLaw, sites: Array) -> ElementValues:
    """Values of the elements with these centroids (n, 3); sites (k, 3) are the places used; both LPS, mm.

    One c everywhere: every element is `assumed`, and its limits are not known (NaN).
    """
    n = len(centroids)
    away = np.full(n, np.nan)
    if len(sites):
        away = np.linalg.norm(centroids[:, None] - sites[None], axis=2).min(axis=1)
    unknown = np.full(n, np.nan)
    return ElementValues(
        np.full(n, stiffness.c), unknown, unknown, np.full(n, float(LABELS.index(ASSUMED))), away,
        np.full(n, stiffness.m), np.full(n, stiffness.f_kappa),
    )  # fmt: skip


def field_values(found: CaseField, centroids: Array, volumes: Array) -> tuple[ElementValues, TissueLaw]:
    """Values of the elements with these centroids (n, 3), LPS, mm, by the field, and their (geometric) means.

    volumes (n,) mm3 : weights of the means
    """
    m, f_kappa = (found.field.values_of(name, centroids).value for name in ("m", "f_kappa"))
    values = ElementValues(*found.element_columns(centroids), m, f_kappa)
    sites = tuple(each.name for each in found.field.sites)
    source = f"field through {_listed(sites)}"
    c, f_kappa_mean, m_mean = (
        float(np.exp(np.average(np.log(each), weights=volumes))) for each in (values.c, f_kappa, m)
    )
    return values, TissueLaw(c, f_kappa_mean, m_mean, source, sites)


def sample_of(n: int) -> IntArray:
    """Every n-th of n elements, `_SAMPLE` at most: enough for means over a limb."""
    return np.arange(0, n, max(1, -(-n // _SAMPLE)))


def model_of_draw(model: LimbModel, block: Block, draw: Draw, centroids: Array) -> LimbModel:
    """The model with the tissue element by element as one draw has it."""
    drawn = draw.at(centroids)
    return with_element_values(model, block, drawn.c, m=drawn.m, f_kappa=drawn.f_kappa)


def with_element_values(
    model: LimbModel, block: Block, c: Array, *, m: Array | float, f_kappa: Array | float
) -> LimbModel:
    """The model whose tissue has c1, c2 and kappa element by element, and m1 and m2 if m is.

    c (n_cells,) MPa; m and f_kappa (n_cells,), or one for all
    """
    one = float(np.mean(m))
    law = ogden_type(c=float(c.mean()), f_kappa=float(np.mean(f_kappa)), m=one)
    by_name = {"c1": 0.5 * c, "c2": 0.5 * c, "kappa": f_kappa * c}
    if np.ptp(m) > 0:
        by_name |= {"m1": np.asarray(m), "m2": -np.asarray(m)}
    maps = {name: ElementMap(f"{block.name}_{name}", block.name, each) for name, each in by_name.items()}
    return replace(model, materials={**model.materials, block.name: law.with_parameters(**maps)})


def columns_of(values: ElementValues) -> dict[str, Array]:
    """The values as they are written for others: kPa, mm, label as its index in `LABELS`."""
    return {
        "c_kpa": kpa_from_mpa(values.c), "c_low_kpa": kpa_from_mpa(values.c_low),
        "c_high_kpa": kpa_from_mpa(values.c_high), "label": values.label, "distance_mm": values.distance,
        "m": values.m, "f_kappa": values.f_kappa,
    }  # fmt: skip
