"""Options of `fit`, and checks that they are compatible."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from limbcli.errors import CaseError
from limbcli.measurement.levels import LAST
from limbcli.provenance.requested_options import in_words, requested_by_options
from limbcli.site_model.indentation_model import C_KPA

OBJECTIVES = ("force", "joint", "states")
COMPARISON = "--compare-element"

# Fields of FitOptions that have no effect on each kind of fit. `joint` and `states` search on a surrogate
# with its own stopping rule and always compute intervals; a comparison of elements is of two plain fits.
_OF_FORCE = ("tolerance", "max_iterations", "intervals", "templates", "time_limit_s")
_SAYS_NOTHING: Mapping[str, Sequence[str]] = {
    "joint": _OF_FORCE,
    "states": (
        "c_kpa", "c_deviation", "contact_check", "boundary_check", "cycle", "stiffness_map", "compare_laws",
        *_OF_FORCE,
    ),
    COMPARISON: (
        "c_deviation", "intervals", "gain_deviation", "contact_check", "boundary_check", "templates",
        "time_limit_s",
    ),
}  # fmt: skip


@dataclass(frozen=True)
class FitOptions:
    """Options of all kinds of fit.

    c_kpa : c given by hand (None: from the shear-wave speed at level 0), with its relative
        standard deviation `c_deviation` (None: that of the shear-wave reading)
    stiffness_map : use c(x), element by element, from the shear-wave map of level 0
    intervals : compute profile intervals (more simulations) instead of standard errors only
    gain_deviation : relative numerical error of the force that intervals include (None: from
        `mesh --study` if it was run, else by element type and edge length)
    cycle : the cycle whose loading is fitted, a number or "last" (the last one with three levels of loading)
    contact_check : solve the fitted model again with a stiffer contact and report the change
    boundary_check : the same with the cut plane free, and with the far side of the limb held; the intervals
        allow for both
    law : of the fits `joint` and `states`, one of `fitting.laws.LAWS`
    compare_laws : in the joint fit, fit all laws and compare them by held-out error
    max_interval_solves : greatest number of simulations (of rounds of them for `states`) added for the
        intervals; None: as many as are usual for the fit
    """

    c_kpa: float | None = None
    c_deviation: float | None = None
    stiffness_map: bool = False
    tolerance: float = 1e-3
    max_iterations: int = 50
    intervals: bool = True
    gain_deviation: float | None = None
    contact_check: bool = True
    boundary_check: bool = True
    cycle: str = LAST
    templates: Path | None = None
    time_limit_s: float | None = None
    law: str = "ogden"
    compare_laws: bool = False
    max_interval_solves: int | None = None

    def requested(self, kind: str = "force") -> dict[str, Any]:
        """The options needed to repeat a run of this kind (an objective or `COMPARISON`).

        >>> FitOptions(tolerance=0.01, contact_check=False).requested(COMPARISON)
        {'tolerance': 0.01}
        """
        unheard = _SAYS_NOTHING.get(kind, ())
        return {key: value for key, value in requested_by_options(self).items() if key not in unheard}

    def most_solves(self, usual: int) -> int:
        """`max_interval_solves`, or the usual number."""
        return usual if self.max_interval_solves is None else self.max_interval_solves


def check_choice(
    objective: str, options: FitOptions, *, compare_element: bool = False, solver: str = "auto",
    febio: Path | None = None,
) -> None:  # fmt: skip
    """Raise CaseError if the objective is unknown, FEBio is asked of a fit that only the reference solver
    supports, or an option has no effect on the requested fit."""
    if objective not in OBJECTIVES:
        fix = f"use {', '.join(OBJECTIVES[:-1])} or {OBJECTIVES[-1]}"
        raise CaseError(f"there is no objective {objective!r}", where="--objective", fix=fix)
    joint, choice = objective != "force", COMPARISON if compare_element else f"--objective {objective}"
    asked = requested_by_options(options)
    of_joint = next((in_words({key: True}) for key in ("law", "compare_laws") if key in asked), "")
    of_febio = "--solver" if solver == "febio" else "--febio" if febio is not None else ""
    unheard = _SAYS_NOTHING.get(COMPARISON if compare_element else objective, ())
    given = {key: value for key, value in asked.items() if key in unheard}
    for is_wrong, what, where, fix in (
        (
            joint and compare_element, "two conflicting options are given",
            f"--objective {objective}, {COMPARISON}", "give one at a time",
        ),
        (
            of_joint and not joint, f"{of_joint} has no effect on the fit of the force alone", of_joint,
            "add --objective joint (or states), or omit it",
        ),
        (
            of_febio and (joint or compare_element), "this requires derivatives that FEBio does not provide",
            "--solver febio" if solver == "febio" else of_febio,
            f"omit {of_febio}: the reference solver supports it",
        ),
        (
            options.stiffness_map and (joint or compare_element),
            "a stiffness map is supported only by the fit of the force alone", "--stiffness-map",
            f"omit --objective {objective} and {COMPARISON}, or the map",
        ),
        (
            objective == "states" and options.compare_laws, "laws are compared by the joint fit only",
            "--compare-laws, --objective states", "give one law (--law), or use --objective joint",
        ),
        (
            given, f"{in_words(given)} has no effect on {choice}", choice,
            "omit it, or fit the force alone (--objective force)",
        ),
    ):  # fmt: skip
        if is_wrong:
            raise CaseError(what, where=where, fix=fix)


def check_numbers(options: FitOptions) -> None:
    """Raise CaseError, which names the option and its range, if a number given by hand is out of range."""
    if options.cycle != LAST and not (options.cycle.isdecimal() and int(options.cycle) >= 1):
        fix = "give the number of a cycle (1, 2, ...) or last"
        raise CaseError(f"--cycle is {options.cycle!r}", where="--cycle", fix=fix)
    rules = (
        ("--c-kpa", options.c_kpa, *C_KPA, "c = 2 mu in kPa; soft tissue has 2 to 50"),
        ("--c-deviation-fraction", options.c_deviation, 0.0, 2.0, "a share of c, e.g. 0.1"),
        ("--tolerance", options.tolerance, 1e-9, 0.1, "relative, e.g. 1e-3"),
        ("--time-limit-s", options.time_limit_s, 1e-3, 1e9, "seconds"),
        ("--gain-deviation-fraction", options.gain_deviation, 0.0, 2.0, "a share of the force, e.g. 0.03"),
    )
    for name, value, low, high, meaning in rules:
        if value is not None and not low <= value <= high:
            raise CaseError(
                f"{name} is {value:g}; possible values are {low:g} to {high:g}",
                where=name,
                fix=f"give {meaning}",
            )
