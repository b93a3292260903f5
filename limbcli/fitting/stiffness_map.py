"""The stiffness map of a fit: c(x) from the level-0 wave speeds on the elements of a site's model.

The map, c(x) = 2 rho v0(x)^2, lies in the image plane (lateral, depth). It is smoothed, extruded along
elevation, and fades into its median where nothing was measured, so that values are neither invented nor
discontinuous.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator
from scipy.spatial import cKDTree

from limbcli.case import Site
from limbcli.drawing import save_figure
from limbcli.errors import CaseError, MeasurementError, MeshError
from limbcli.errors.problems import raise_errors
from limbcli.inference.profile_intervals import Stiffness
from limbcli.measurement.elastography import SweMap, check_mean, check_width, map_file, read_map
from limbcli.measurement.indentation import Levels
from limbcli.measurement.shear_modulus import shear_modulus_from_wave_speed
from limbcli.model import Array, ElementMap, LimbModel, Mesh
from limbcli.numbers.units import kpa_from_mpa
from limbcli.reporting.figures.section import cut_tetrahedra, linear_tetrahedra, outline
from limbcli.reporting.figures.style import INK, bare, facets, new_figure, style
from limbcli.results import StageWriter
from limbcli.site_model.indentation_model import PROBE, TISSUE

_MOST_OUTSIDE = 0.2  # share of the map's pixels outside the model's tissue above which a warning is given


@dataclass(frozen=True, eq=False)
class TissueMap:
    """c of every element of the tissue (MPa), and the shear-wave map from which it was computed.

    median : median of the map, MPa, which is also c of all elements far from the map
    n_inside : number of elements within the image; n_outside : number of pixels outside the model's tissue
    """

    c: ElementMap
    swe: SweMap
    median: float
    n_inside: int
    n_outside: int

    @property
    def words(self) -> str:
        low, high = (kpa_from_mpa(float(each)) for each in (self.c.values.min(), self.c.values.max()))
        return (
            f"2 rho v^2 of the shear-wave map at level 0, element by element: median "
            f"{kpa_from_mpa(self.median):.2f} kPa, {low:.2f} to {high:.2f} kPa"
        )

    def stiffness(self, site: Site) -> Stiffness:
        """The median, and the standard deviation of its logarithm, which combines the error common to all
        pixels of a level with the error of a single pixel divided by the square root of their number."""
        noise = site.noise
        own = noise.swe_pixel_fraction / np.sqrt(len(self.swe))
        return Stiffness(self.median, 2.0 * float(np.hypot(noise.swe_level_fraction, own)))


def tissue_map(model: LimbModel, site: Site, *, row: int = 0) -> TissueMap:
    """c(x) = 2 rho v0(x)^2 at the centre of every tissue element, from the map of the level in this row.

    Raises CaseError if the site has no maps; MeasurementError if that map is missing, faulty, too small, or
    outside the model; MeshError if the tissue is not a single block.
    """
    swe = _level_0(site, row)
    raise_errors(check_width(swe, probe_length(model)), MeasurementError)
    names = [each.block for each in model.domains if each.material == TISSUE]
    if len(names) != 1:
        raise MeshError(
            f"{len(names)} blocks are made of {TISSUE!r}; a stiffness map needs one",
            where=", ".join(names) or "the model has none",
            fix="mesh without layers, or fit without --stiffness-map",
        )
    block = model.mesh.block(names[0])
    middles = model.mesh.points[block.cells].mean(axis=1)
    c, inside, median = stiffness_at(swe, middles, density_kg_per_m3=site.density_kg_per_m3)
    if not inside.any():
        raise MeasurementError(
            f"the shear-wave map of level 0 lies outside the model: lateral {_ends_words(swe.lateral)}, "
            f"depth {_ends_words(swe.depth)} hold none of its {len(middles)} elements",
            where=str(swe.path),
            fix="lateral_mm is 0 under the probe's centre, depth_mm is 0 at its face and grows downwards",
        )
    c_map = ElementMap(f"{TISSUE}_c", block.name, c)
    return TissueMap(c_map, swe, median, int(inside.sum()), _without_tissue(swe, middles))


def probe_length(model: LimbModel) -> float:
    """Length of the probe's face along x, mm; 0 if the model has no probe."""
    blocks = next((each.blocks for each in model.bodies if each.name == PROBE), ())
    nodes = model.mesh.nodes_of(blocks)
    return float(np.ptp(model.mesh.points[nodes, 0])) if len(nodes) else 0.0


def _level_0(site: Site, row: int) -> SweMap:
    if site.swe_maps is None:
        raise CaseError(
            f"site {site.name} has no shear-wave maps to make a stiffness map from",
            where="case.toml, [[site]]",
            fix='give their folder (swe_maps = "folder"), or fit without --stiffness-map',
        )
    path = map_file(site.swe_maps, row)
    if not path.is_file():
        raise MeasurementError(
            f"there is no shear-wave map of level 0 ({path.name})",
            where=str(site.swe_maps),
            fix="export the map at 0 N, or fit without --stiffness-map",
        )
    return read_map(path)


def _ends_words(values: Array) -> str:
    return f"{values.min():g} to {values.max():g} mm"


def _without_tissue(swe: SweMap, middles: Array) -> int:
    """Number of pixels without an element nearby, relative to the local element size."""
    tree = cKDTree(middles)
    places = np.column_stack([swe.lateral, np.zeros(len(swe)), -swe.depth])
    distance, nearest = tree.query(places)
    spacing = tree.query(middles[nearest], k=min(9, len(middles)))[0][:, -1]
    return int((distance > spacing).sum())


def write_tissue_map(
    found: TissueMap, model: LimbModel, levels: Levels, site: Site, writer: StageWriter
) -> None:
    """Write the map's entry in fit.json and its figure, and a warning if it disagrees with the levels."""
    assert found.swe.path is not None
    writer.used("swe_map_level_0", found.swe.path)
    values = kpa_from_mpa(found.c.values)
    writer.data["stiffness_map"] = {
        "map": found.swe.path.name, "n_pixels": len(found.swe), "n_pixels_without_tissue": found.n_outside,
        "n_elements": len(values), "n_elements_within_image": found.n_inside,
        "median_kpa": kpa_from_mpa(found.median),
        "low_kpa": float(values.min()), "high_kpa": float(values.max()),
        "smoothing_mm": SMOOTHING, "fade_mm": FADE,
        "extruded": "along elevation; outside the image it fades into the median",
    }  # fmt: skip
    writer.summary.append(
        f"stiffness map: {found.n_inside} of {len(values)} elements within the image ({found.words})"
    )
    writer.warnings.extend(_warnings(found, levels))
    picture = stiffness_figure(model.mesh, found.c, found.swe)
    save_figure(picture, writer.file("stiffness_map", "stiffness-map.png"))


def _warnings(found: TissueMap, levels: Levels) -> list[str]:
    warnings = []
    if found.n_outside > _MOST_OUTSIDE * len(found.swe):
        warnings.append(
            f"{found.n_outside} of {len(found.swe)} pixels of the stiffness map are where the model "
            "has no tissue: check lateral_mm, depth_mm and the site's position"
        )
    if not levels.begins_at_zero:
        warnings.append(
            f"there is no level 0: the stiffness map is that of {levels.force[0]:g} N and "
            f"{levels.depth[0]:g} mm, of tissue that is already loaded"
        )
    odd = check_mean(found.swe, float(levels.swe_mean_m_per_s[0]))
    return warnings + [
        f"{map_file(Path(), int(levels.rows[0])).name}: {each.what} ({each.fix})" for each in odd
    ]


_COLOURS = {"skin": INK, "bone": "#7a4b12"}


def stiffness_figure(mesh: Mesh, c: ElementMap, swe: SweMap) -> Figure:
    """x-z section at y = 0, before loading: c element by element, and the position of the image."""
    block, c_kpa = mesh.block(c.block), kpa_from_mpa(c.values)
    tetrahedra, parent = linear_tetrahedra(block.kind, block.cells)
    cut = cut_tetrahedra(mesh.points, tetrahedra)
    corners = cut.at(mesh.points)[:, [0, 2]]
    with style():
        span = np.ptp(corners, axis=0)
        figure = new_figure(6.4, min(max(5.2 * span[1] / span[0], 2.0), 6.0) + 1.6)
        axes = figure.add_subplot()
        values, scale = c_kpa[parent[cut.cells]], _range(c_kpa)
        drawn = facets(axes, corners[cut.triangles], array=values, cmap="viridis", norm=scale)
        for name in (each for each in _COLOURS if each in mesh.surfaces):
            lines = list(outline(mesh.points, mesh.surfaces[name].facets, mesh.points))
            axes.add_collection(LineCollection(lines, colors=_COLOURS[name], lw=1.3, label=name))
        (left, right), (top, bottom) = _ends(swe.lateral), _ends(-swe.depth)
        axes.plot(
            [left, right, right, left, left], [top, top, bottom, bottom, top],
            "--", color="#d0342c", lw=1.4, label="the shear-wave image",
        )  # fmt: skip
        axes.autoscale_view()
        bare(axes)
        axes.set(xlabel="x, along the probe's long side [mm]", ylabel="z, outward along the skin normal [mm]")
        axes.set_title("c = 2ρv² at level 0, element by element")
        figure.colorbar(drawn, ax=axes, label="c [kPa]", shrink=0.9)
        figure.legend(loc="outside lower center", ncols=3)
    return figure


def _range(values: Array) -> Normalize:
    """Limits of the colour scale; a uniform map is placed in its middle."""
    low, high = float(values.min()), float(values.max())
    margin = 0.0 if high - low > 1e-3 * high else 0.05 * high
    return Normalize(low - margin, high + margin)


def _ends(values: Array) -> tuple[float, float]:
    return float(values.min()), float(values.max())


SMOOTHING = 3.0  # mm, deviation of the Gaussian over the pixels (about what a wave-speed pixel averages)
FADE = 6.0  # mm, distance over which a value fades into the median outside the map
_LEAST_PIXELS = 12


def stiffness_at(
    swe: SweMap, points: Array, *, density_kg_per_m3: float = 1000.0
) -> tuple[Array, NDArray[np.bool_], float]:
    """c (MPa) at points (n_points, 3) mm of a site's model, from its map of level 0; whether each lies in the
    image; and the median, which is c far from it.

    Raises MeasurementError if the map has fewer than a dozen pixels or they are collinear.
    """
    if len(swe) < _LEAST_PIXELS:
        raise MeasurementError(
            f"the wave-speed map of level 0 has {len(swe)} pixels; a stiffness map needs {_LEAST_PIXELS}",
            where=str(swe.path),
            fix="fit without --stiffness-map, or export the map with more pixels",
        )
    places = np.column_stack([swe.lateral, swe.depth])
    c = 2.0 * shear_modulus_from_wave_speed(swe.speed_m_per_s, density_kg_per_m3=density_kg_per_m3)
    log_c = _smoothed(places, np.log(c))
    at = np.column_stack([points[:, 0], -points[:, 2]])
    value = _interpolated(places, log_c, at, swe)
    in_plane = np.isfinite(LinearNDInterpolator(places, np.ones(len(places)))(at))  # in the convex hull
    tree = cKDTree(places)
    outside = np.maximum(tree.query(at)[0] - np.median(tree.query(places, k=2)[0][:, 1]), 0.0)
    weight = np.exp(-0.5 * (np.where(in_plane, 0.0, outside) / FADE) ** 2)
    median = float(np.median(log_c))
    c = np.exp(weight * value + (1.0 - weight) * median)
    return c, in_plane, float(np.exp(median))


def _smoothed(places: Array, values: Array) -> Array:
    """Gaussian average over the pixels around each pixel."""
    tree = cKDTree(places)
    near = tree.query_ball_point(places, 3.0 * SMOOTHING)
    out = np.empty_like(values)
    for k, each in enumerate(near):
        weight = np.exp(-0.5 * ((places[each] - places[k]) ** 2).sum(axis=1) / SMOOTHING**2)
        out[k] = weight @ values[each] / weight.sum()
    return out


def _interpolated(places: Array, values: Array, at: Array, swe: SweMap) -> Array:
    """Linear interpolation inside the map's convex hull, the nearest pixel's value outside."""
    if np.linalg.matrix_rank(places - places.mean(axis=0), tol=1e-6) < 2:
        raise MeasurementError(
            "the pixels of the wave-speed map lie on one line",
            where=str(swe.path),
            fix="export a map with rows and columns",
        )
    linear = LinearNDInterpolator(places, values)(at)
    return np.where(np.isnan(linear), NearestNDInterpolator(places, values)(at), linear)
