"""Uncertainty of a fit due to an assumed (not imaged) geometry, computed by varying the assumptions.

The fitted model's mesh is morphed to other shapes and solved again at the fitted parameters. Each variation
(`geometry_variations`) is one standard deviation; two opposite ones have weight one half each. None of them
changes c, which comes from the shear-wave speed.
"""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from limbcli.case import Case, Site
from limbcli.errors import LimbError
from limbcli.fitting.geometry_variations import Variation, depth_deviation, shaped, variations
from limbcli.fitting.table import NAMES, Identified, inside
from limbcli.inference.adaptive import Intervals
from limbcli.inference.geometry_uncertainty import ends, shifts, total_share
from limbcli.inference.two_step_fit import sensitivities
from limbcli.meshing.rods import Rod
from limbcli.model import Array, LimbModel
from limbcli.numbers.significant_digits import short
from limbcli.progress import SILENT, Progress
from limbcli.provenance.batch_memory import key_of
from limbcli.results import StageWriter, plain, read_result, stage_folder
from limbcli.solvers.session import ReferenceSession

FILE = "geometry.json"
NOT_ALLOWED_FOR = (
    "the intervals do not include the uncertainty of the assumed geometry; those of `limbcli fit` do"
)
_TOLERANCE = 1e-4


@dataclass(frozen=True, eq=False)
class Varied:
    """A variation and ln of the force ratio that it causes at the model's levels (n_levels,).

    part : share of the variation that the cells could take; why_not : reason in words if it was not solved,
        and log_force NaN
    """

    variation: Variation
    log_force: Array
    part: float = 1.0
    why_not: str = ""


@dataclass(frozen=True, eq=False)
class GeometryUncertainty:
    """All variations of one site's model; `words` states what was assumed."""

    words: str
    varied: tuple[Varied, ...]
    n_solves: int
    seconds: float

    @property
    def done(self) -> tuple[Varied, ...]:
        return tuple(each for each in self.varied if np.isfinite(each.log_force).all())

    @property
    def modes(self) -> Array:
        """Changes of ln force (n_modes, n_levels), one standard deviation each."""
        return np.sqrt(self.weights)[:, None] * np.array([each.log_force for each in self.done])

    @property
    def weights(self) -> Array:
        """Weights (n_modes,) in the variance of each kind: 1/2 in a pair, 1 if the opposite failed."""
        kinds = [each.variation.kind for each in self.done]
        return np.array([1.0 / kinds.count(each) for each in kinds])


def site_geometry_uncertainty(
    case: Case, site: Site, out: Path, fitted: LimbModel, forces: Array, writer: StageWriter, *,
    progress: Progress = SILENT,
) -> GeometryUncertainty | None:  # fmt: skip
    """The uncertainty due to a site's assumed geometry, or what an earlier fit of the same model kept; None
    if imaged, or if no variation could be solved. forces : (n_levels,) N of the fitted model"""
    if not case.imaging.assumed:
        return None
    segmented, meshed = read_result(out, "segment"), read_result(out, "mesh", site=site.name)
    geometry, frame = segmented.data["geometry"], meshed.data["frame"]
    writer.used_result(segmented, data=["geometry"])
    writer.used_result(meshed, data=["frame"])
    depth = depth_deviation(site.noise.depth, geometry["sites"][site.name])
    todo = variations(case.imaging, depth=depth, bones=len(geometry["bones"]))
    law = {name: vars(each) for name, each in fitted.materials.items()}
    points = fitted.mesh.points.round(6).tobytes()
    key = key_of(
        points, plain(law), plain(geometry), frame["patient_from_model"], todo, forces.round(6).tolist()
    )
    known = _remembered(stage_folder(out, "fit", site.name) / FILE, key, todo)
    if known is None:
        progress.event("note", text=f"the geometry is assumed: {len(todo)} simulations with varied geometry")
        rod = rod_in_model(geometry, site.name, np.array(frame["patient_from_model"]))
        known = _solve_all(fitted, forces, rod, todo, progress)
    found = replace(known, words=geometry["words"])
    content = {"key": key, "n_solves": found.n_solves, "seconds": found.seconds, "varied": [
        {"log_force": each.log_force, "part": each.part, "why_not": each.why_not} for each in found.varied
    ]}  # fmt: skip
    writer.file("geometry", FILE).write_text(json.dumps(plain(content), indent=1), encoding="utf-8")
    for each in found.varied:
        if each not in found.done:
            writer.warnings.append(f"{each.variation.words} was not evaluated: {each.why_not}")
    return found if found.done else None


def rod_in_model(geometry: Mapping[str, Any], site: str, patient_from_model: Array) -> Rod:
    """The bone below a site as a rod in the site's frame; `towards` points from its axis to the site."""
    bone = geometry["bones"][geometry["sites"][site]["bone"]]
    to_model = np.linalg.inv(patient_from_model)
    turn = to_model[:3, :3]
    centre, axis = turn @ np.array(bone["centre_mm"]) + to_model[:3, 3], turn @ np.array(bone["axis"])
    up = np.array([0.0, 0.0, 1.0])
    towards = up - (up @ axis) * axis
    return Rod(
        centre, axis, float(bone["radius_mm"]), float(bone["from_mm"]), float(bone["to_mm"]),
        towards / np.linalg.norm(towards),
    )  # fmt: skip


def _solve_all(
    fitted: LimbModel, forces: Array, rod: Rod, todo: tuple[Variation, ...], progress: Progress
) -> GeometryUncertainty:
    clock = time.perf_counter()
    found: list[Varied] = []
    before: ReferenceSession | None = None
    for number, each in enumerate(todo, 1):
        progress.event("task", name=f"geometry: {each.words}", done=number, total=len(todo))
        try:
            model, part = shaped(fitted, rod, each)
            session = ReferenceSession(model, progress=progress, tolerance=_TOLERANCE)
            if before is not None:
                session.start_like(before)
                before.close()
            before = session
            solved = session.solve(model).must_points.forces
            change = np.log(np.maximum(solved, 1e-9) / np.maximum(forces, 1e-9)) / part
            found.append(Varied(each, np.asarray(change), part))
        except LimbError as error:
            found.append(Varied(each, np.full(len(forces), np.nan), why_not=error.what))
    if before is not None:
        before.close()
    return GeometryUncertainty("", tuple(found), len(todo), time.perf_counter() - clock)


def _remembered(path: Path, key: str, todo: tuple[Variation, ...]) -> GeometryUncertainty | None:
    """Results stored by an earlier fit of the same model, or None."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        if content["key"] != key:
            return None
        varied = [
            Varied(each, np.array(row["log_force"], dtype=float), row["part"], row["why_not"])
            for each, row in zip(todo, content["varied"], strict=True)
        ]
        return GeometryUncertainty("", tuple(varied), 0, float(content["seconds"]))
    except (OSError, ValueError, KeyError, TypeError):
        return None


def write_geometry(
    found: Identified, uncertainty: GeometryUncertainty, of_noise: Intervals | None, writer: StageWriter
) -> None:
    """Write `geometry_uncertainty` of fit.json, beside the intervals `of_noise` alone, and a summary line."""
    rows = _rows(found, uncertainty)
    share = total_share(list(uncertainty.modes))
    # standard deviations of ln f_kappa and ln m due to the geometry alone
    squares = {name: np.square([each["log_shift"][name] for each in rows]) for name in NAMES}
    deviations = {name: float(np.sqrt(uncertainty.weights @ each)) for name, each in squares.items()}
    reported: dict[str, Any] = {
        "words": uncertainty.words, "gain_fraction": share, "variations": rows,
        "n_solves": uncertainty.n_solves, "seconds": uncertainty.seconds,
        "interval_95_noise": ends(of_noise) if of_noise is not None else {},
        "interval_95": ends(found.intervals[-1]) if found.intervals else {},
        "standard_error_fraction": deviations,
    }  # fmt: skip
    writer.data["geometry_uncertainty"] = reported
    if uncertainty.words not in writer.warnings:
        writer.warnings.insert(0, uncertainty.words)
    writer.summary.append(
        f"the assumed geometry contributes a force uncertainty of {short(100 * share, 2)} % (one standard "
        f"deviation, {len(uncertainty.done)} shapes)"
    )


def _rows(found: Identified, uncertainty: GeometryUncertainty) -> list[dict[str, Any]]:
    step = found.steps[-1]
    answer = sensitivities(found, step.theta)
    free = inside(step)
    moved = np.full((len(uncertainty.done), len(NAMES)), np.nan)
    if free:
        change = np.array([each.log_force for each in uncertainty.done])
        moved[:, free] = shifts(answer.slopes[:, free], found.moved(step.theta, change))
    return [
        {
            "kind": each.variation.kind, "words": each.variation.words, "part": each.part,
            "weight": weight, "force_change_fraction": np.expm1(each.log_force),
            "log_shift": dict(zip(NAMES, row, strict=True)),
        }
        for each, weight, row in zip(uncertainty.done, uncertainty.weights, moved, strict=True)
    ]  # fmt: skip
