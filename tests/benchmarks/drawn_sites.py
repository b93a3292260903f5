"""Sites with a hidden effect, drawn by seed: case folders and truth, to be scored as those that FEBio made.

    python -m tests.benchmarks.drawn_sites --out SET [--first 1] [--count 24] [--margin-mm 57] [--twins]
    python SHARED/febio-hidden/score.py run --limbcli limbcli --cases SET --out OUT
    python SHARED/febio-hidden/score.py table --cases SET --out OUT

What the FEBio study cannot be any more: new. Limbs of OpenLimb (the reference data), places, tissues and
sizes of effects are drawn from the number alone. Every tissue is simulated with and without what is hidden,
on another mesh than a diagnosis has, of the whole surfaces, cut 57 mm beyond the probe (110: not at all),
with a contact that gives less; lighter surfaces are handed over. The probe stands upright on the skin near
its middle, its long axis level. A wave speed is that of places all over the elements in a slice of 4 mm,
under a Gaussian of 3 mm: not the way in which a diagnosis reads its own. SET/truth.toml has the form of the
study's. The solver is the project's own, which agrees with FEBio on the same mesh.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.optimize import minimize_scalar

from limbcli.effects import effect
from limbcli.effects.stiffness_places import layer_share
from limbcli.effects.tissue import core, ground_modulus, scaled, tissue_block, with_core
from limbcli.errors import LimbError, MeshError
from limbcli.fem.elements.element import reference_gradients, shape
from limbcli.measurement.elastography import SweMap, map_file, write_map
from limbcli.meshing.frame import skin_point_at
from limbcli.meshing.mending import Limb
from limbcli.meshing.probe import ProbeShape
from limbcli.meshing.remesh import Sizes
from limbcli.meshing.site_model import MeshOptions, site_model
from limbcli.meshing.surfaces import Triangles
from limbcli.model import Array, LimbModel
from limbcli.phantom.beam import skin_bone_distance
from limbcli.phantom.case_folder import PROBE, NoiseLaw, case_table, toml
from limbcli.progress import SILENT
from limbcli.shear_waves.speed import block_speeds
from limbcli.site_model.indentation_model import PROBE as PROBE_BODY
from limbcli.site_model.indentation_model import TISSUE, with_penalty
from limbcli.solvers.solver import Simulation
from limbcli.stages.simulated_subjects.hidden_effects import hide
from limbcli.stages.simulated_subjects.indent import KnownTissue, Press
from tests.benchmarks.mesh_sites import limbs as known
from tests.benchmarks.seeded_rows import NO_RESULT, Row, made, succeeded

Change = Callable[[LimbModel], LimbModel]
PENALTY, TOLERANCE, FAR, FACES = 80.0, 1e-4, 14.0, (8000, 2500)  # faces of skin and of each bone
STRAIN, BEYOND, MOST_LEVELS = 0.37, 0.01, 12  # depth over thickness: of the levels, pressed beyond them
STEPS, AT_LEAST = (2.0, 1.0, 0.5), 7  # N between levels: the largest that gives so many
LAW, TRAVEL_MM, SKIN_BONE_MM, HOLD = NoiseLaw(), 0.05, 0.3, 20.0
SHAPE = ProbeShape(PROBE.length, PROBE.width, PROBE.edge_radius)
THICK, EVEN = (30.0, 50.0), 0.7  # mm of tissue under the probe; least of it over that at its centre
LATERAL, BELOW = np.arange(-20.0, 20.5), np.arange(2.0, 25.5)
SLICE, SMOOTHING, N_PLACES = 2.0, 3.0 / 2.355, 30  # half thickness; standard deviation; in an element
FULL = 2 * SLICE * 2 * np.pi * SMOOTHING**2  # mm3 of tissue that a pixel averages
# what is hidden, and what is measured: force and depth, beside them means or maps of wave speed
KINDS = (
    ("none", "map"), ("tilt", "map"), ("inclusion", "map"), ("swe-guided-wave", "map"),
    ("force-zero", "mean"), ("skin-layer", "map"), ("none", "map"), ("adipose-layer", "map"),
    ("depth-zero", "map"),
    ("nonlinearity", "map"), ("preload", "map"), ("support-motion", "mean"), ("none", "mean"),
    ("swe-depth-bias", "map"), ("thickness", "map"), ("contraction", "map"), ("swe-time-scale", "map"),
    ("inclusion+force-zero", "map"), ("convex-face", "map"), ("inclusion", "map"), ("anisotropy", "map"),
    ("none", "map"), ("load-cell-saturation", "map"), ("tilt", "map"),
)  # fmt: skip
OUTSIDE = ("convex-face", "load-cell-saturation")


@dataclass(frozen=True, eq=False)
class Curve:
    """Force N over depth, and ln speed (n, lateral, below the face) at the simulated depths (n,)."""

    depth: Array
    force: Array
    log_speed: Array

    def at(self, force: Array) -> tuple[Array, Array]:
        """Depths and ln speeds at forces (k,), by PCHIP of depth over force."""
        rising = np.r_[True, np.diff(self.force) > 1e-6]
        depth = np.asarray(PchipInterpolator(self.force[rising], self.depth[rising])(force))
        k = np.clip(np.searchsorted(self.depth, depth) - 1, 0, len(self.depth) - 2)
        share = ((depth - self.depth[k]) / (self.depth[k + 1] - self.depth[k]))[:, None, None]
        return depth, (1 - share) * self.log_speed[k] + share * self.log_speed[k + 1]


@dataclass(eq=False)
class Hidden:
    """What is hidden: sizes as the study's table names them, what it does to the model and the readings."""

    sizes: dict[str, dict[str, Any]] = field(default_factory=dict)
    change: Change | None = None
    offset: float = 0.0  # N
    zero: float = 0.0  # mm
    preload: float = 0.0  # N
    saturates: float = np.inf  # N
    from_level: int = 0
    thicker: float = 1.0  # times
    speeds: Callable[[Array, Array], Array] | None = None  # of m/s (k, lateral, below) and depth (k,)
    travel: Callable[[Array, Array], Array] | None = None  # of depth and force


# ---------------------------------------------------------------- what is hidden


def drawn(kind: str, rng: np.random.Generator, thick: float, c_kpa: float) -> Hidden:
    """One of `KINDS` with sizes such as the study has."""
    out = Hidden()
    for name in kind.split("+"):
        if name != "none":
            out.sizes[name] = _HIDDEN[name](out, rng, thick, c_kpa)
    return out


def _either(rng: np.random.Generator, low: float, high: float) -> float:
    return float(rng.choice([-1, 1]) * rng.uniform(low, high))


def _tilt(out: Hidden, rng: np.random.Generator, thick: float, c_kpa: float) -> dict:
    short = _either(rng, 5.0, 9.0)
    theta = {"tilt_about_short_axis_deg": short, "tilt_about_long_axis_deg": 0.0}
    out.change = lambda model: effect("tilt").apply(model, theta)
    return {"about_short_axis_deg": short, "about_long_axis_deg": 0.0}


def _inclusion(out: Hidden, rng: np.random.Generator, thick: float, c_kpa: float) -> dict:
    middle = np.array([rng.uniform(-12, 12), rng.uniform(-3, 3), -rng.uniform(9, min(22, thick - 12))])
    radius = rng.uniform(5.0, 9.0)
    ratio = float(rng.choice([rng.uniform(0.25, 0.45), rng.uniform(2.5, 5.0)]))

    def change(model: LimbModel) -> LimbModel:
        corners = model.mesh.points[tissue_block(model).cells[:, :4]]
        weights = np.random.default_rng(0).dirichlet(np.ones(4), 60)
        away = np.linalg.norm(np.einsum("wk,nkd->wnd", weights, corners) - middle, axis=2)
        return scaled(model, 1 + (ratio - 1) * (away < radius).mean(axis=0))

    out.change = change
    return {"radius_mm": radius, "stiffness_ratio": ratio, "centre_mm": middle.tolist()}


def _skin(out: Hidden, rng: np.random.Generator, thick: float, c_kpa: float) -> dict:
    deep, ratio = rng.uniform(1.1, 1.6), rng.uniform(14.0, 26.0)
    out.change = lambda model: scaled(model, 1 + layer_share(model, deep) * (ratio - 1))
    return {"thickness_mm": deep, "c_kpa": ratio * c_kpa}


def _fat(out: Hidden, rng: np.random.Generator, thick: float, c_kpa: float) -> dict:
    deep, ratio = rng.uniform(4.0, 9.0), rng.uniform(0.25, 0.45)
    out.change = lambda model: scaled(model, 1 + layer_share(model, deep) * (ratio - 1))
    return {"thickness_mm": deep, "stiffness_ratio": ratio}


def _nonlinear(out: Hidden, rng: np.random.Generator, thick: float, c_kpa: float) -> dict:
    q = float(rng.choice([rng.uniform(0.05, 0.2), rng.uniform(0.8, 0.95)]))

    def change(model: LimbModel) -> LimbModel:
        law, c = core(model.materials[TISSUE]), ground_modulus(model)
        return with_core(model, replace(law, parameters={**law.parameters, "c1": q * c, "c2": (1 - q) * c}))

    out.change = change
    return {"q": q}


def _fibres(out: Hidden, rng: np.random.Generator, thick: float, c_kpa: float) -> dict:
    size = rng.uniform(1.0, 2.0)
    out.change = hide(f"anisotropy={size:.4f}").in_model
    return {"mu_f_kpa": size * c_kpa}


def _contraction(out: Hidden, rng: np.random.Generator, thick: float, c_kpa: float) -> dict:
    stress, out.from_level = rng.uniform(2.0, 5.0), int(rng.integers(0, 6))
    theta = {"active_stress_per_c": stress / c_kpa}
    out.change = lambda model: effect("contraction").apply(model, theta)
    return {"t0_kpa": stress, "from_level": out.from_level}


def _thickness(out: Hidden, rng: np.random.Generator, thick: float, c_kpa: float) -> dict:
    epsilon = _either(rng, 0.08, 0.15)
    out.thicker = 1 + epsilon
    out.change = lambda model: effect("thickness").apply(model, {"thickness_change": epsilon})
    return {"epsilon": epsilon}


def _convex(out: Hidden, rng: np.random.Generator, thick: float, c_kpa: float) -> dict:
    sag = rng.uniform(1.0, 2.5)

    def change(model: LimbModel) -> LimbModel:
        nodes = np.unique(np.concatenate([model.mesh.block(b).cells.ravel() for b in model.bodies[0].blocks]))
        points = model.mesh.points.copy()
        points[nodes, 2] += sag * (points[nodes, 0] / (PROBE.length / 2)) ** 2
        return replace(model, mesh=replace(model.mesh, points=points))

    out.change = change
    return {"sag_mm": sag}


def _force_zero(out: Hidden, rng: np.random.Generator, thick: float, c_kpa: float) -> dict:
    out.offset = _either(rng, 0.6, 1.2)
    return {"f0_n": out.offset}


def _depth_zero(out: Hidden, rng: np.random.Generator, thick: float, c_kpa: float) -> dict:
    out.zero = _either(rng, 0.9, 1.6)
    return {"d0_mm": out.zero}


def _preload(out: Hidden, rng: np.random.Generator, thick: float, c_kpa: float) -> dict:
    out.preload = rng.uniform(0.6, 1.4)
    return {"f0_n": out.preload}


def _saturation(out: Hidden, rng: np.random.Generator, thick: float, c_kpa: float) -> dict:
    out.saturates = rng.uniform(25.0, 45.0)
    return {"f_s_n": out.saturates}


def _support(out: Hidden, rng: np.random.Generator, thick: float, c_kpa: float) -> dict:
    k, jump, after = rng.uniform(8.0, 20.0), rng.uniform(0.3, 0.8), int(rng.integers(3, 6))
    out.travel = lambda depth, force: depth + force / k + jump * (np.arange(len(depth)) > after)
    return {"k_n_per_mm": k, "jump_mm": jump, "jump_after_level": after}


def _time_scale(out: Hidden, rng: np.random.Generator, thick: float, c_kpa: float) -> dict:
    s = rng.uniform(0.5, 0.75)
    out.speeds = lambda v, depth: v / np.sqrt(s)
    return {"s_t": s}


def _depth_bias(out: Hidden, rng: np.random.Generator, thick: float, c_kpa: float) -> dict:
    beta = _either(rng, 0.008, 0.018)
    out.speeds = lambda v, depth: v * (1 - beta * (BELOW - 8.0))
    return {"beta_per_mm": beta, "z_ref_mm": 8.0}


def _guided(out: Hidden, rng: np.random.Generator, thick: float, c_kpa: float) -> dict:
    """A cut-off at which the speed at rest is read 4 to 10 % too high."""
    v = np.sqrt(c_kpa / 2)
    f_c = 1e3 * v / (2 * thick) / np.sqrt(1 - rng.uniform(1.04, 1.1) ** -2)

    def change(speed: Array, depth: Array) -> Array:
        ratio = 1e3 * speed / (2 * (thick - depth)[:, None, None] * f_c)
        return speed / np.sqrt(1 - np.minimum(ratio**2, 0.9))

    out.speeds = change
    return {"f_c_hz": f_c}


_HIDDEN: dict[str, Callable[[Hidden, np.random.Generator, float, float], dict]] = {
    "tilt": _tilt, "inclusion": _inclusion, "skin-layer": _skin, "adipose-layer": _fat,
    "nonlinearity": _nonlinear, "anisotropy": _fibres, "contraction": _contraction, "thickness": _thickness,
    "convex-face": _convex, "force-zero": _force_zero, "depth-zero": _depth_zero, "preload": _preload,
    "load-cell-saturation": _saturation, "support-motion": _support, "swe-time-scale": _time_scale,
    "swe-depth-bias": _depth_bias, "swe-guided-wave": _guided,
}  # fmt: skip


# ---------------------------------------------------------------- simulation


def pressed(meshed: LimbModel, tissue: KnownTissue, hidden: Change | None, deepest: float) -> Curve:
    """The tissue pressed until all levels are reached, with what its waves would show."""

    def change(model: LimbModel) -> LimbModel:
        hard = with_penalty(model, PENALTY)
        return hard if hidden is None else hidden(hard)

    press = Press(meshed=meshed, tissue=tissue, tolerance=TOLERANCE, progress=SILENT, change=change)
    model, found = press.until(STEPS[0] * (MOST_LEVELS + 1), deepest)
    offset = float(model.info.get("depth_offset_mm", 0.0))
    depth = np.r_[0.0, found.probe_depth(PROBE_BODY) + offset]
    force = np.r_[0.0, found.probe_force(PROBE_BODY)]
    return Curve(depth, force, np.log(speeds_of(model, found, depth)))


def speeds_of(model: LimbModel, found: Simulation, depth: Array) -> Array:
    """m/s (n, lateral, below the face), NaN where little tissue is: at places all over each element, of the
    deformation there."""
    first = next(iter(found.elements.values())).items  # those that the scanner may show
    kind = model.mesh.solid_blocks[0].kind
    cells = np.concatenate([each.cells for each in model.mesh.solid_blocks if each.kind == kind])[first]
    nodes = next(iter(found.nodes.values()))
    moved = np.zeros((len(depth), *model.mesh.points.shape))
    for axis, name in enumerate(("ux", "uy", "uz")):
        moved[1:, nodes.items, axis] = nodes.column(name)
    shares = np.random.default_rng(0).dirichlet(np.ones(4), N_PLACES)[:, 1:]
    chosen = shares, np.full(N_PLACES, 1 / 6 / N_PLACES)
    slope, _ = reference_gradients(model.mesh.points, cells, kind, chosen)
    values, _ = shape(kind, shares)
    out = np.full((len(depth), len(LATERAL), len(BELOW)), np.nan)
    for n, d in enumerate(depth):
        F = np.eye(3) + np.einsum("cni,cqnj->cqij", moved[n][cells], slope, optimize=True)
        speed = block_speeds(model, TISSUE, F.reshape(-1, 3, 3), np.repeat(first, N_PLACES))
        now = (model.mesh.points + moved[n])[cells]
        a, b, c, e = np.moveaxis(now[:, :4], 1, 0)
        volume = np.abs(np.einsum("ij,ij->i", np.cross(b - a, c - a), e - a)) / 6 / N_PLACES
        at = np.einsum("wk,nkd->nwd", values, now).reshape(-1, 3)
        inside = (np.abs(at[:, 1]) <= SLICE) & np.isfinite(speed)
        x, z = at[inside, 0], -d - at[inside, 2]
        size = np.repeat(volume, N_PLACES)[inside]
        ex = np.exp(-0.5 * ((LATERAL[:, None] - x) / SMOOTHING) ** 2)
        ez = np.exp(-0.5 * ((BELOW[:, None] - z) / SMOOTHING) ** 2)
        weight = (ex * size) @ ez.T
        mean = (ex * size * speed[inside]) @ ez.T / np.maximum(weight, 1e-12)
        out[n] = np.where(weight > FULL / 2, mean, np.nan)
    return out


# ---------------------------------------------------------------- readings


@dataclass(frozen=True, eq=False)
class Record:
    """What is read, without noise: a row a level."""

    force: Array
    depth: Array
    log_speed: Array
    travel: Array


def step_for(top: float) -> float:
    """N between levels up to `top`."""
    return next((step for step in STEPS if top >= AT_LEAST * step), STEPS[-1])


def recorded(plain: Curve, changed: Curve, hidden: Hidden, forces: Array) -> Record:
    """At true forces (k,) from 0 up, counted from the preload."""
    true = forces + hidden.preload
    depth, waves = changed.at(true)
    if hidden.from_level:
        before, calm = plain.at(true)
        late = np.arange(len(true)) >= hidden.from_level
        depth, waves = np.where(late, depth, before), np.where(late[:, None, None], waves, calm)
    travel = depth if hidden.travel is None else hidden.travel(depth, true)
    if hidden.speeds is not None:
        waves = np.log(hidden.speeds(np.exp(waves), depth))
    read = forces + hidden.offset
    if np.isfinite(hidden.saturates):
        read = hidden.saturates * -np.expm1(-read / hidden.saturates)
    shown = depth - depth[0] - np.where(np.arange(len(depth)) > 0, hidden.zero, 0.0)
    return Record(read, shown, waves, travel - travel[0] + (shown - depth + depth[0]))


def visibility(
    plain: Curve, changed: Record, hidden: Hidden, channels: str, thick: float, true_thick: float
) -> dict:
    """chi2 of what is hidden in the raw readings, after the plain tissue has chosen its c."""

    def parts(factor: float) -> dict[str, float]:
        depth, waves = plain.at(np.clip(changed.force / factor, 0.0, plain.force[-1]))
        off = changed.log_speed - waves - 0.5 * np.log(factor)
        rising = np.maximum.accumulate(plain.force) + 1e-6 * np.arange(len(plain.force))
        slope = np.gradient(plain.depth, rising)
        per_n = np.interp(changed.force / factor, plain.force, slope) / factor
        size = LAW.depth_mm**2 + (LAW.force_n * np.minimum(per_n, 20.0)) ** 2
        apart = (changed.depth - (depth - depth[0]))[1:] ** 2 / size[1:]
        means = np.nanmean(off, axis=(1, 2))
        found = {"force_depth": apart.sum(), "swe_mean": (means**2).sum() / LAW.swe_level_fraction**2}
        if channels == "map":
            own = (off - means[:, None, None]) / LAW.swe_pixel_fraction
            found["swe_pattern"] = np.nansum(own**2)
        return found

    best = minimize_scalar(lambda x: sum(parts(np.exp(x)).values()), bounds=(-0.7, 0.7), method="bounded")
    out = {f"refit_{key}": float(value) for key, value in parts(float(np.exp(best.x))).items()}
    out["refit_c_factor"] = float(np.exp(best.x))
    if hidden.travel is not None:
        out["travel"] = float((((changed.travel - changed.depth) / TRAVEL_MM) ** 2).sum())
    out["skin_bone"] = len(changed.force) * ((true_thick - thick) / SKIN_BONE_MM) ** 2
    return out


def written(
    folder: Path, record: Record, channels: str, bone: float | None, travel: bool, rng: np.random.Generator
) -> None:
    """levels.csv and maps, with noise."""
    n = len(record.force)
    later = np.arange(n) > 0
    force = record.force + LAW.force_n * rng.standard_normal(n)
    depth = record.depth + LAW.depth_mm * rng.standard_normal(n) * later
    table = {"force_n": force, "depth_mm": depth, "hold_s": np.full(n, HOLD)}
    common = 1 + LAW.swe_level_fraction * rng.standard_normal(n)
    own = 1 + LAW.swe_pixel_fraction * rng.standard_normal(record.log_speed.shape)
    speed = np.exp(record.log_speed) * common[:, None, None] * own
    table["swe_mean_m_per_s"] = np.nanmean(speed, axis=(1, 2))
    table["swe_sd_m_per_s"] = np.nanstd(speed, axis=(1, 2))
    table["swe_pixels"] = np.isfinite(speed).sum(axis=(1, 2)).astype(float)
    if bone is not None:
        table["skin_bone_mm"] = bone - record.depth + SKIN_BONE_MM * rng.standard_normal(n)
    if travel:
        table["probe_travel_mm"] = record.travel + TRAVEL_MM * rng.standard_normal(n) * later
    folder.mkdir(parents=True)
    digits = {"swe_pixels": 0}
    columns = [[f"{x:.{digits.get(name, 3)}f}" for x in values] for name, values in table.items()]
    rows = [",".join(table), *map(",".join, zip(*columns, strict=True))]
    (folder / "levels.csv").write_text("\n".join(rows) + "\n")
    if channels == "map":
        x, z = (each.ravel() for each in np.meshgrid(LATERAL, BELOW, indexing="ij"))
        for k, each in enumerate(speed.reshape(n, -1)):
            good = np.isfinite(each)
            path = map_file(folder / "swe", k)
            path.parent.mkdir(exist_ok=True)
            write_map(path, SweMap(x[good], z[good], each[good]))


# ---------------------------------------------------------------- one site


def lighter(surface: Triangles, n_faces: int) -> Triangles:
    import pymeshlab

    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(surface.points, surface.faces))
    if len(surface.faces) > n_faces:
        meshes.meshing_decimation_quadric_edge_collapse(targetfacenum=n_faces, preservenormal=True)
    found = meshes.current_mesh()
    return Triangles(found.vertex_matrix(), found.face_matrix().astype(np.int64))


def axis_on(skin: Triangles, point: Array, reach: float = 17.0) -> Array:
    """Long axis (3,), level and across the skin's mean normal within `reach` of the point."""
    away = np.linalg.norm(skin.centroids - point, axis=1)
    normal = skin.area_vectors[away < reach].sum(axis=0)
    x = np.cross([0.0, 0.0, 1.0], normal)
    return np.asarray(x / np.linalg.norm(x))


@dataclass(frozen=True, eq=False)
class Place:
    """Where on which limb, and its fine mesh; thick : mm of tissue under the probe's centre."""

    name: str
    limb: Limb
    point: Array
    axis: Array
    meshed: LimbModel
    thick: float


def place(
    rng: np.random.Generator, limbs: list[tuple[str, Limb, tuple[float, float]]], size: float, margin: float
) -> Place:
    """A place whose tissue is as thick as in the study, and about as thick all under the probe."""
    options = MeshOptions(sizes=Sizes(under_probe=size, far=FAR), margin=margin)
    for _ in range(40):
        name, limb, _ = limbs[int(rng.integers(len(limbs)))]
        length = np.ptp(limb.skin.points[:, 2])
        angle, height = float(rng.uniform(40, 320)), float(rng.uniform(0.3, 0.7) * length)
        point = np.round(skin_point_at(limb, angle, height), 2)
        axis = axis_on(limb.skin, point)
        try:
            made = site_model(limb, tuple(point), tuple(axis), SHAPE, options)
        except LimbError as error:
            print(f"  {name} at {angle:.0f} deg, {height:.0f} mm: {error.what}", flush=True)
            continue
        thick, least = skin_bone_distance(made.model), made.checks.thinnest_under_probe_mm
        if thick is not None and least is not None and THICK[0] < thick < THICK[1] and least > EVEN * thick:
            return Place(name, limb, point, axis, made.model, thick)
    raise MeshError("none of 40 places drawn is thick enough", where="a site's place", fix="draw another")


def bring(folder: Path, where: Place, channels: str) -> None:
    """case.toml and surfaces."""
    from tests.benchmarks.openlimb_case import write_stl

    (folder / "surfaces").mkdir(parents=True)
    names = ["surfaces/skin.stl", *(f"surfaces/bone{k}.stl" for k in range(len(where.limb.bones)))]
    for k, (name, body) in enumerate(zip(names, [where.limb.skin, *where.limb.bones], strict=True)):
        write_stl(folder / name, lighter(body, FACES[min(k, 1)]))
    site = {
        "name": "p1", "position_mm": where.point.tolist(), "levels": "p1/levels.csv",
        "long_axis": where.axis.round(4).tolist() if channels == "map" else "transverse",
        "density_kg_per_m3": 1000.0, "noise": {**vars(LAW), "source": "repeats"},
    }  # fmt: skip
    if channels == "map":
        site["swe_maps"] = "p1/swe"
    imaging = {"skin": names[0], "bones": names[1:]}
    (folder / "case.toml").write_text(toml(case_table(subject_id=folder.name, imaging=imaging, sites=[site])))


def one(
    number: int,
    out: Path,
    limbs: list[tuple[str, Limb, tuple[float, float]]],
    size: float,
    margin: float,
    *,
    twin: bool,
) -> list[dict]:
    """Case folders, and their entries in truth.toml; twin : also one of the tissue without what is hidden."""
    rng = np.random.default_rng([2026, number])
    kind, channels = KINDS[(number - 1) % len(KINDS)]
    tissue = KnownTissue(rng.uniform(5.5, 10.5), rng.uniform(50.0, 100.0), rng.uniform(2.1, 6.0))
    where = place(rng, limbs, size, margin)
    thick = where.thick
    hidden = drawn(kind, rng, thick, tissue.c_kpa)
    deepest = (STRAIN + BEYOND) * thick
    plain = pressed(where.meshed, tissue, None, deepest)
    changed = plain if hidden.change is None else pressed(where.meshed, tissue, hidden.change, deepest)
    top = min(np.interp(STRAIN * thick, each.depth, each.force) for each in (plain, changed)) - hidden.preload
    step = step_for(top)
    forces = np.asarray(step * np.arange(min(int(top / step) + 1, MOST_LEVELS)), dtype=float)
    found = []
    for letter, curve, effects in [("d", changed, hidden), ("n", plain, Hidden())][: 2 if twin else 1]:
        folder = out / f"{letter}{number:02d}"
        bring(folder, where, channels)
        record = recorded(plain, curve, effects, forces)
        seen = "thickness" in effects.sizes or number % 5 == 1
        true_thick = thick * effects.thicker
        travel = "support-motion" in effects.sizes or number % 4 == 1
        written(folder / "p1", record, channels, true_thick if seen else None, travel, rng)
        shows = visibility(plain, record, effects, channels, thick, true_thick if seen else thick)
        np.savez_compressed(out / f"exact-{folder.name}.npz", **vars(record))
        outside = any(each in OUTSIDE for each in effects.sizes)
        found.append({
            "id": folder.name, "effects": list(effects.sizes) or ["none"],
            "answer": "none" if not effects.sizes else "outside" if outside else "+".join(effects.sizes),
            "acceptable": [], "channels": channels, "limb": where.name, "thickness_mm": thick,
            "c_kpa": tissue.c_kpa, "m": tissue.m, "fk": tissue.f_kappa, "parameters": effects.sizes,
            "visibility": {"p1": {"levels": len(forces), **(shows if effects.sizes else {})}},
        })  # fmt: skip
    return found


def line(row: Row) -> str:
    if NO_RESULT in row:
        return f"d{row['number']:02d}: {row[NO_RESULT]}"
    first = row["case"][0]
    return f"{first['id']} {'+'.join(first['effects'])}, {first['limb']}, {first['thickness_mm']:.1f} mm"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--count", type=int, default=len(KINDS))
    parser.add_argument("--size-mm", type=float, default=4.0)
    parser.add_argument("--margin-mm", type=float, default=57.0, help="beyond the probe; 110: the whole limb")
    parser.add_argument("--twins", action="store_true", help="each also without what is hidden")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    limbs = [each for each in known() if each[0] != "visible-human"]

    def folders(number: int) -> Row:
        truths = one(number, options.out, limbs, options.size_mm, options.margin_mm, twin=options.twins)
        return {"case": truths}

    jobs = {(number,): number for number in range(options.first, options.first + options.count)}
    rows = made(options.out / "sites.jsonl", jobs, folders, key=("number",), show=line)
    truths = [each for row in sorted(succeeded(rows), key=lambda row: row["number"]) for each in row["case"]]
    (options.out / "truth.toml").write_text("format = 1\n" + toml({"case": truths}))


if __name__ == "__main__":
    main()
