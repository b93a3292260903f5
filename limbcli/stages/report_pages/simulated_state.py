"""Where a site is on its limb, and its simulated state, read from results of stages for the report."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from limbcli.case import Case, Site
from limbcli.errors import LimbError, SolveError
from limbcli.feb.log import LogReader
from limbcli.feb.outline import read_outline
from limbcli.feb.read import read_feb
from limbcli.meshing.surfaces import Triangles, read_surface
from limbcli.model import Array, IntArray, LimbModel
from limbcli.progress import PROGRESS_FILE, read_events
from limbcli.reporting.figures.convergence import Residuals
from limbcli.reporting.figures.deformed import DeformedState
from limbcli.reporting.figures.limb_views import LimbPlace
from limbcli.reporting.outcome import Outcomes
from limbcli.results import UNLIKE_OURS, StageResult
from limbcli.solvers.record_tables import read_tables
from limbcli.solvers.solver import LOG_FILE, MODEL_FILE, Table

_MODEL_FILES = ("fitted.feb", MODEL_FILE)
_GRADIENT = tuple(f"F{row}{column}" for row in "xyz" for column in "xyz")


def read_deformed(result: StageResult) -> DeformedState | None:
    """The last converged state of a stage's simulation, or None if there is none.

    Raises LimbError if model or records cannot be read, or contain no displacements.
    """
    feb = next((path for name in _MODEL_FILES if (path := result.folder / name).is_file()), None)
    if feb is None:
        return None
    outline = read_outline(feb)
    model, tables = read_feb(feb), read_tables(outline, feb.parent)
    _check_end(tables.times, outline.end_time, feb)
    kind, cells, numbers = _tissue(model)
    probe = model.bodies[0].name if model.bodies else "probe"
    rigid = tables.rigid[probe]
    places = np.stack([rigid.column(axis)[:, 0] for axis in "xyz"], axis=1)
    start = np.asarray(model.bodies[0].center_of_mass) if model.bodies else places[0]
    return DeformedState(
        points=model.mesh.points,
        displacement=_displacement(model, tables.nodes, feb),
        kind=kind,
        cells=cells,
        skin=_facets(model, "skin", "contact"),
        bone=_facets(model, "bone"),
        probe=_probe_facets(model),
        probe_shift=places[-1] - start,
        depth=-float(places[-1, 2]),
        stretch=_shortest(tables.elements, numbers),
        cut=_facets(model, "cut"),
    )


def _check_end(times: Array, end_time: float | None, feb: Path) -> None:
    """Raise SolveError if the records end before the load: they are truncated, even if after a whole step."""
    if end_time is not None and (not len(times) or times[-1] < end_time * (1 - 1e-6)):
        reached = f"{times[-1]:g}" if len(times) else "no step"
        raise SolveError(
            f"the record files end at time {reached}, the load at {end_time:g}",
            where=str(feb.parent),
            fix="run the simulation again",
        )


def _tissue(model: LimbModel) -> tuple[str, IntArray, IntArray]:
    """Element type and cells of the solid blocks of the first one's type, and their indices in the model."""
    solid = model.mesh.solid_blocks
    kind = solid[0].kind
    cells, numbers, first = [], [], 0
    for block in model.mesh.blocks:
        if block.is_solid and block.kind == kind:
            cells.append(block.cells)
            numbers.append(np.arange(first, first + len(block.cells)))
        first += len(block.cells)
    return kind, np.concatenate(cells), np.concatenate(numbers)


def _displacement(model: LimbModel, nodes: Mapping[str, Table], feb: Path) -> Array:
    """Displacement (n_points, 3), mm, at the last time; NaN where a node was not recorded."""
    table = _table_with(nodes, ("ux", "uy", "uz"))
    if table is None:
        raise SolveError(
            "the simulation recorded no displacements",
            where=str(feb),
            fix="run it again with limbcli's templates: they request the nodes' displacements",
        )
    found = np.full(model.mesh.points.shape, np.nan)
    found[table.items] = np.stack([table.column(name)[-1] for name in ("ux", "uy", "uz")], axis=1)
    return found


def _shortest(elements: Mapping[str, Table], numbers: IntArray) -> Array | None:
    """Smallest principal stretch (n_cells,) at the last time; NaN where not recorded."""
    table = _table_with(elements, _GRADIENT)
    if table is None:
        return None
    gradient = np.stack([table.column(name)[-1] for name in _GRADIENT], axis=1).reshape(-1, 3, 3)
    size = int(max(numbers.max(), table.items.max())) + 1
    every = np.full(size, np.nan)
    every[table.items] = np.linalg.svd(gradient, compute_uv=False)[:, 2]  # the principal stretches
    return every[numbers]


def _table_with(tables: Mapping[str, Table], fields: tuple[str, ...]) -> Table | None:
    return next((each for each in tables.values() if set(fields) <= set(each.fields)), None)


def _facets(model: LimbModel, *names: str) -> dict[str, IntArray]:
    """Facets of the first of these surfaces that the model has."""
    for name in names:
        if name in model.mesh.surfaces:
            return dict(model.mesh.surfaces[name].facets)
    return {}


def _probe_facets(model: LimbModel) -> dict[str, IntArray]:
    facets: dict[str, list[IntArray]] = {}
    for block in model.mesh.blocks:
        if not block.is_solid:
            facets.setdefault(block.kind, []).append(block.cells)
    return {kind: np.concatenate(each) for kind, each in facets.items()}


def read_residuals(result: StageResult) -> Residuals | None:
    """Largest ratio of a norm to its target in every solver iteration, from the log or recorded events."""
    log, events = result.folder / LOG_FILE, result.folder / PROGRESS_FILE
    found: list[tuple[int, float, float]] = []
    if log.is_file():
        reader = LogReader()
        with log.open(encoding="utf-8", errors="replace") as stream:
            for line in stream:
                reader.feed(line)
        found = [(each.step, *each.worst()) for each in reader.iterations]
    if not found and events.is_file():
        newton = [each for each in read_events(events) if each["kind"] == "newton"]
        found = [(each["step"], each["residual"], each["target"]) for each in newton]
    found = [each for each in found if each[2] > 0.0]
    if not found:
        return None
    steps, now, target = np.array(found, dtype=float).T
    return Residuals(now / target, steps.astype(np.int64))


_NEAR_MM = 15.0  # the part of the skin, along the limb, whose middle tells which way is outwards


def limb_skin(outcomes: Outcomes) -> Triangles | None:
    """The skin that `segment` wrote, or None if there is none that can be read."""
    segmented = outcomes.of("segment").usable
    if segmented is None or "skin" not in segmented.files:
        return None
    try:
        return read_surface(segmented.path("skin"))
    except (LimbError, OSError, ValueError):
        return None


def limb_place(case: Case, site: Site, skin: Triangles | None, outcomes: Outcomes) -> LimbPlace | None:
    """The site on the skin; None without a skin, or if the site's position is not known."""
    if skin is None:
        return None
    try:
        framed = _framed(case, site, skin, outcomes.of("mesh", site.name).usable)
        return framed or _unframed(case, site, skin, outcomes.of("segment").usable)
    except UNLIKE_OURS:
        return None


def _framed(case: Case, site: Site, skin: Triangles, meshed: StageResult | None) -> LimbPlace | None:
    """The place with the probe's face, as `mesh` found it."""
    if meshed is None or "frame" not in meshed.data:
        return None
    frame = meshed.data["frame"]
    place, outward, along = (np.array(frame[key], float) for key in ("skin_point_mm", "normal", "long_axis"))
    across = np.cross(outward, along)
    half = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * [case.probe.length / 2, case.probe.width / 2]
    return LimbPlace(
        name=site.name, limb=case.limb, points=skin.points, triangles=skin.faces, place=place,
        outward=outward, face=place + half @ np.stack([along, across]),
    )  # fmt: skip


def _unframed(case: Case, site: Site, skin: Triangles, segmented: StageResult | None) -> LimbPlace | None:
    """The place that the case states or a marker has, before `mesh`."""
    place = site.position
    if place is None and segmented is not None:
        markers = {each["number"]: each["position_mm"] for each in segmented.data.get("markers", ())}
        place = markers.get(site.marker)
    if place is None:
        return None
    point = np.array(place, float)
    return LimbPlace(
        name=site.name, limb=case.limb, points=skin.points, triangles=skin.faces, place=point,
        outward=point - _middle(skin, point),
    )  # fmt: skip


def _middle(skin: Triangles, point: Array) -> Array:
    """The middle of the limb's section at the height of a point, at that height."""
    near = skin.points[np.abs(skin.points[:, 2] - point[2]) < _NEAR_MM]
    middle = (near if len(near) else skin.points).mean(axis=0)
    return np.array([middle[0], middle[1], point[2]])
