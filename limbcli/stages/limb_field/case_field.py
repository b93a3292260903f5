"""The stiffness field of a case in one call, and its values for the elements of a mesh."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from limbcli.case import Case
from limbcli.errors import CaseError
from limbcli.model import Array
from limbcli.numbers.units import kpa_from_mpa, mpa_from_kpa
from limbcli.provenance.staleness import Chain
from limbcli.results import StageWriter
from limbcli.stages.cohort import RESULT, read_cohort
from limbcli.stages.limb_field.site_results import LimbReadings, site_results
from limbcli.stiffness_field import (
    LABELS,
    PARAMETERS,
    PRIORS,
    FieldPrior,
    ForceReading,
    LimbCoordinates,
    StiffnessField,
    contradictions,
    held_out,
    stiffness_field,
)
from limbcli.stiffness_field.likelihood import REACH


@dataclass(frozen=True, eq=False)
class CaseField:
    """The field of a case, and the readings that it comes from.

    force_on_limb : by site, the limb's simulated force at the deepest level over that of the fit
    """

    field: StiffnessField
    results: LimbReadings
    force_on_limb: Mapping[str, float] = dataclasses.field(default_factory=dict)

    def element_columns(self, points: Array) -> tuple[Array, Array, Array, Array, Array]:
        """Of points (n, 3), mm, LPS: c, c_low, c_high (MPa), index of the label in `LABELS`, distance (mm,
        NaN where no site was read)."""
        found = self.field.at(points)
        index = np.array([LABELS.index(each) for each in found.label.tolist()], float)
        return found.c, found.c_low, found.c_high, index, np.where(
            np.isfinite(found.distance), found.distance, np.nan
        )  # fmt: skip

    def tissue_of(self, name: str) -> Array:
        """ln of the field's c (MPa), m, f_kappa (3,) at a site: means over what it averages."""
        points = next(each.points for each in self.field.sites if each.name == name)
        return np.array([np.log(self.field.values_of(each, points).value).mean() for each in PARAMETERS])

    def _of_force(self, name: str, force: ForceReading) -> dict[str, Any]:
        return {
            "limb_over_site": float(force.limb_over_site[np.argmax(force.depths)]),
            "force_of_field": force.ratio(self.tissue_of(name)),
            "force_on_limb": self.force_on_limb.get(name),
        }

    def to_json(self) -> dict[str, Any]:
        """Sites, hypotheses, held-out test and priors, as plain values with units in the keys."""
        field = self.field
        tested = held_out(field)
        return {
            "sites": {
                each.name: {
                    "source": each.source,
                    **{
                        ("c_kpa" if name == "c" else name): _in_kpa(name, [v.value, v.low, v.high])
                        for name, v in each.values.items()
                    },
                    **({} if each.force is None else self._of_force(each.name, each.force)),
                }
                for each in field.sites
            },
            "maps": {each.site: {"n_squares": len(each.log_c)} for each in field.maps},
            "left_out": dict(self.results.left_out),
            "contradictions": contradictions(field),
            "priors": {
                name: {
                    "median" if name != "c" else "median_kpa": _in_kpa(name, [float(np.exp(each.mean))])[0],
                    "deviation_of_ln": each.deviation, "source": each.source,
                }
                for name, each in field.priors.items()
            },
            "hypotheses": [
                {
                    "parameter": name, "length_along_mm": each.lengths.height_mm,
                    "length_around_rad": each.lengths.around, "length_depth": each.lengths.depth,
                    "variation_of_ln": each.variation, "own_error_of_ln": each.own_error,
                    "probability": share,
                }
                for name in PARAMETERS
                for each, share in field.hypotheses(name)
            ],
            "held_out": {
                "words": tested.words, "n_inside": tested.n_inside, "n": len(tested.sites), "p": tested.p,
                "skipped": dict(tested.skipped),
                "sites": [
                    {
                        "site": each.site, "c_kpa": kpa_from_mpa(each.c),
                        "predicted_kpa": kpa_from_mpa(each.predicted),
                        "predicted_95_kpa": [
                            kpa_from_mpa(each.predicted_low), kpa_from_mpa(each.predicted_high)
                        ],
                        "z": each.z, "inside": each.inside,
                    }
                    for each in tested.sites
                ],
            },
        }  # fmt: skip


def case_field(
    case: Case, chain: Chain, limb: LimbCoordinates, writer: StageWriter, *, cohort: Path | None = None,
    location: str | None = None,
) -> CaseField:  # fmt: skip
    """The field of a case from the results in its output folder.

    cohort, location : folder of a cohort's result, and its location whose population is the prior

    Raises CaseError if a result is out of date, or the cohort has no such location; MeasurementError or
    FitError if a map or a reading cannot be used.
    """
    results, priors = site_results(case, chain, writer), PRIORS
    if cohort is not None:
        priors = {**PRIORS, **cohort_priors(cohort, location)}
        writer.used("cohort", cohort / RESULT)
    return CaseField(stiffness_field(limb, results.sites, results.maps, priors=priors), results)


def cohort_priors(folder: Path, location: str | None) -> dict[str, FieldPrior]:
    """Priors of c and m from the population of a cohort's location.

    The population's spread between people and the uncertainty of its mean are added. m is left out where it
    lies beyond the range of the cohort's models.

    location : None: the only one there is

    Raises CaseError if the folder holds no result of `cohort`, or that has no such location.
    """
    sites: Mapping[str, Any] = read_cohort(folder).data["sites"]
    name = location or (next(iter(sites)) if len(sites) == 1 else "")
    if name not in sites:
        what = f"the cohort has no location {name!r}" if name else "the cohort has several locations"
        fix = f"give --cohort-location {' or '.join(sites)}"
        raise CaseError(what, where=str(folder / RESULT), fix=fix)
    found = {}
    for key, parameter, scale in (("c_muscle_kpa", "c", mpa_from_kpa(1.0)), ("m", "m", 1.0)):
        own = sites[name]["population"][key]
        if own["beyond_family"]:
            continue
        found[parameter] = replace(
            PRIORS[parameter], mean=float(np.log(own["geometric_mean"] * scale)),
            deviation=float(np.hypot(own["spread_of_ln"], np.log(own["high"] / own["low"]) / (2 * REACH))),
            source=f"cohort, location {name}, {sites[name]['n_people']} people",
        )  # fmt: skip
    return found


def _in_kpa(name: str, values: Sequence[float | None]) -> list[float | None]:
    if name != "c":
        return list(values)
    return [None if each is None else kpa_from_mpa(each) for each in values]
