"""Data with something hidden in them, on the reduced model, and what the diagnosis says of them.

The truth comes from a finer block, another shape of the deformation, Laplace noise and, where the
library has a simpler form, another form of the effect.
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from limbcli.diagnosis.data.noise_parts import KnownErrors, ModelError
from limbcli.diagnosis.data.rows import ExtraMeasurement, SiteReadings
from limbcli.diagnosis.data.site_data import site_data
from limbcli.diagnosis.explanations.search import containing
from limbcli.diagnosis.explanations.sentences import recommended
from limbcli.diagnosis.explanations.verdict import diagnose
from limbcli.diagnosis.forward_model.measurement_menu import ROTATE, items
from limbcli.diagnosis.forward_model.site_forward_model import SiteForwardModel
from limbcli.diagnosis.forward_model.surrogate import SiteCurves
from limbcli.effects import EFFECTS, effect
from limbcli.effects.reading import Reading
from limbcli.effects.stiffness_places import layer_share
from limbcli.effects.tissue import ground_modulus, limb_axis, scaled, with_part
from limbcli.model import Material
from tests.diagnosis import reduced

USUAL = (6.5, 4.0)  # c in kPa, m
C_KPA_BETWEEN, M_BETWEEN = (4.0, 10.0), (1.5, 12.0)  # where every case has a tissue of its own
LATE = 8 / 14  # of the levels, where an effect sets in late
LARGEST = 2.0  # times the plausible size: skin is not steel
# Patient from model, the limb's axis along the model's y, and along its x: the probe turned by 90 degrees.
ACROSS = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
ALONG = np.array([[0.0, 1, 0, 0], [0, 0, 1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
Truth = Mapping[str, Mapping[str, float]]


class Otherwise:
    """An effect of the library in another form: mildly exponential fibres, a thinner skin."""

    def __init__(self, name: str):
        self.name = name
        self.waves, self.stiffness = effect(name).waves, None

    def apply(self, model, theta):
        if self.name == "anisotropy":
            c = ground_modulus(model)
            fibre = {
                "ksi": theta["fibre_tension_per_c"] * c, "alpha": 1.5, "beta": 2.0,
                "mu": theta["fibre_shear_per_c"] * c, "lam0": 1.0, "fiber": limb_axis(model),
            }  # fmt: skip
            return with_part(model, Material("fiber_exp_pow", fibre))
        if self.name == "skin-layer":
            ratio = 1 + (np.exp(theta["log_skin_ratio"]) - 1) * 1.5 / 1.2
            return scaled(model, 1 + layer_share(model, 1.2) * (ratio - 1))
        return effect(self.name).apply(model, theta)


def outside(shown, curves, protocol):
    """Not in the library: the tissue slackens at one depth (a muscle that slips aside)."""
    depth = protocol.depth
    dip = 0.6 * np.exp(-(((depth - 4.0) / 0.9) ** 2)) - 0.5 * np.exp(-(((depth - 6.5) / 0.7) ** 2))
    return replace(shown, force=shown.force - dip)


@dataclass(frozen=True)
class Grid:
    """Cells of the truth's block and of the fitted one, and their numbers of depths."""

    true_cells: tuple[int, int, int] = (11, 8, 7)
    true_depths: int = 11
    cells: tuple[int, int, int] = (9, 6, 6)
    depths: int = 9


FINE = Grid()
COARSE = Grid((8, 6, 6), 10, (7, 5, 5), 8)


def simulations(cells, n_depths: int, deepest: float, axes: np.ndarray, **more):
    model = reduced.block_model(*cells)
    model = replace(model, info={**model.info, "patient_from_model": axes.ravel().tolist()})
    return reduced.ReducedBook(model, np.linspace(0, deepest, n_depths), **more)


@dataclass
class Case:
    """One hidden truth: `arm` names it, `truth` is effect -> its parameters."""

    arm: str
    truth: Truth
    seed: int
    grid: Grid = FINE
    own_tissue: bool = False

    def __post_init__(self) -> None:
        self.rng = np.random.default_rng([self.seed, zlib.crc32(self.arm.encode())])
        self.c_kpa, self.m = USUAL
        if self.own_tissue:
            self.c_kpa, self.m = (
                float(np.exp(self.rng.uniform(*np.log(each)))) for each in (C_KPA_BETWEEN, M_BETWEEN)
            )
        reading, ingredients = Reading(), []
        for name, theta in self.truth.items():
            known = effect(name)
            if known.solves:
                ingredients.append((Otherwise(name), theta))
            else:
                reading = known.observe(reading, theta)
        if self.arm == "outside":
            reading = Reading(after=(outside,))
        self.ingredients, self.reading = tuple(ingredients), reading
        self.levels = self._measured(ACROSS)

    def _true(self, axes: np.ndarray) -> dict:
        true = simulations(self.grid.true_cells, self.grid.true_depths, 12.0, axes, spread=1.03)
        return {"c": self.c_kpa / 1e3, "m": self.m, "simulations": true}

    def error(self, values: Mapping[str, float]) -> float:
        """|ln c error| + |ln m error|."""
        return float(abs(np.log(values["c_kpa"] / self.c_kpa)) + abs(np.log(values["m"] / self.m)))

    def _measured(self, axes: np.ndarray):
        plain = self.reading == Reading() and not self.truth
        understated = 2.5 if self.arm == "noise understated" else 1.0
        return reduced.measured(
            self.rng, self.ingredients, None if plain else self.reading, understated=understated,
            onset=LATE if self.arm.startswith("late ") else 0.0, **self._true(axes),
        )  # fmt: skip

    def curves(self, levels, axes: np.ndarray = ACROSS, name: str = "p1", extras=()) -> SiteCurves:
        """The fitted side: another block, and allowance for what that changes."""
        fitted = simulations(self.grid.cells, self.grid.depths, 12.0, axes)
        n = len(levels)
        none = np.zeros((n, len(fitted.windows.depths)))
        errors = [
            ModelError("model: mesh", np.full(n, 0.01), none, correlation=0.8),
            ModelError("model: strain by the thickness", np.zeros(n), none, strain=0.5 / reduced.HEIGHT),
            ModelError("model: gain of the force by the geometry", np.full(n, 0.05), none),
        ]
        site = site_data(
            name,
            SiteReadings(levels, reduced.NOISE, windows=fitted.windows, extras=extras),
            KnownErrors(errors=errors),
        )
        return SiteCurves(site, fitted, {e.name: e for e in EFFECTS if e.kind != "numerical"})

    def diagnose(self, *curves: SiteCurves, propose: bool = True, max_effects: int = 2):
        bench = SiteForwardModel(curves or [self.curves(self.levels)])
        if len(bench.sites) == 1:
            bench.turned = self._turned
        return diagnose(bench, seed=self.seed, propose=propose, max_effects=max_effects)

    def _turned(self) -> SiteCurves:
        turned = self.curves(self.levels, ALONG)
        for m in (2.0, 5.0, 10.0):
            turned.solve_nodes([m])
        return turned

    def with_recommended(self, found) -> tuple[str, object] | None:
        """The recommended measurement made on the truth, and the diagnosis with it."""
        best = recommended(found)
        if best is None:
            return None
        name = best.name
        if name == ROTATE:
            again = [self.curves(self.levels), self.curves(self._measured(ALONG), ALONG, "p1-turned")]
            return name, self.diagnose(*again, propose=False)
        item = next(each for each in items() if each.name == name)
        curves, reading, protocol = reduced.truth(self.ingredients, self.reading, **self._true(ACROSS))
        y = item.see(curves, reading, protocol)
        deviation = item.deviations(protocol, len(y))
        y = y + deviation * self.rng.standard_normal(len(y))
        error = None if item.model_error is None else item.model_error(self.curves(self.levels))
        extra = ExtraMeasurement(name, item.see, y, deviation, error)
        return name, self.diagnose(self.curves(self.levels, extras=[extra]), propose=False)


def theta_of(name: str, sizes: Mapping[str, Mapping[str, float]], times: float) -> dict[str, float]:
    """So many times the detectable size, at most `LARGEST` times the plausible one."""
    known = effect(name)
    theta = dict(known.grid[0])
    first = known.parameters[0]
    largest = LARGEST * abs(first.typical - first.null)
    times = min(times, largest / max(abs(sizes[name][first.name]), 1e-9))
    for p in known.parameters:
        theta[p.name] = float(np.clip(p.null + times * sizes[name][p.name], p.low, p.high))
    return theta


def detectable(grid: Grid = FINE) -> dict[str, dict[str, float]]:
    """Size of each effect that is found with 80 % power, from a diagnosis of data with nothing in them."""
    found = Case("nothing", {}, 0, grid).diagnose(propose=False)
    sizes = {}
    for spot in found.blind_spots:
        times = spot.detectable_times_typical
        sizes[spot.name] = {p.name: times * (p.typical - p.null) for p in effect(spot.name).parameters}
    return sizes


def account(case: Case, found, *, follow: bool = True) -> dict:
    """One data set as a line of the study."""
    first, last = found.shrink[0], found.shrink[-1]
    row = {
        "arm": case.arm,
        "seed": case.seed,
        "truth": sorted(case.truth),
        "verdict": found.verdict,
        "chosen": sorted(found.chosen),
        "set": [sorted(each) for each in found.confidence_set],
        "chi2_per_nu": [first.chi2_per_nu, last.chi2_per_nu],
        "probability": {
            "nothing": found.nothing,
            "adequate_from": found.adequate_from,
            "named": containing(found.chosen, found.explanations) if found.chosen else 0.0,
            "truth": next(
                (e.probability for e in found.explanations if set(e.explanation) == set(case.truth)), 0.0
            ),
        },
        "probabilities": [
            [sorted(each.explanation), each.probability]
            for each in found.explanations
            if each.probability > 1e-4
        ],
        "held_out": [each.held_out.get("all") for each in (first, last)],
        "error": [case.error(each.values) for each in (first.estimates, found.estimates)],
        "values": [dict(each.values) for each in (found.shrink[0].estimates, found.estimates)],
        "intervals": [dict(each.intervals) for each in (found.shrink[0].estimates, found.estimates)],
        "true": {"c_kpa": case.c_kpa, "m": case.m},
        "recommended": None,
        "set_after": None,
    }
    late = case.arm.startswith("late ")  # the recommended measurement is not synthesised for those
    if follow and found.verdict == "ambiguous" and case.truth and not late:
        more = case.with_recommended(found)
        if more is not None:
            row["recommended"], after = more[0], more[1]
            row["set_after"] = [sorted(each) for each in after.confidence_set]
            row["expected_probability"] = recommended(found).expected_probability
    return row
