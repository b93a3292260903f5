"""fit with fibres: speed at rest, what orientations determine, and the effect of an uncertain direction."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from limbcli.case import Site
from limbcli.effects.tissue import TISSUE, fibre_direction
from limbcli.errors import MeasurementError, SolveError
from limbcli.fitting.force_curves import LawCurve
from limbcli.fitting.laws import FitLaw
from limbcli.inference.site_depth import RestSpeed
from limbcli.meshing.fibres_from_angles import mean_axis
from limbcli.model import Array, ElementMap, IntArray, LimbModel, Value
from limbcli.numbers.units import mpa_from_pa
from limbcli.results import StageWriter, data_if_there
from limbcli.shear_waves.any_law import acoustic_tensor
from limbcli.shear_waves.from_simulation import MEAN_WINDOW
from limbcli.shear_waves.pixels import pixel_averages

_MATTERS = 0.05  # relative change of force or speed above which a warning is given
_LEAST_IN_SKIN = 1e-6


def stated_deviation(out: Path, site: Site) -> float | None:
    """Standard deviation of the site's fibre direction (deg), from the result of `mesh`; None if unknown."""
    fibres = data_if_there(out, "mesh", site=site.name).get("fibres") or {}
    value = fibres.get("deviation_deg")
    return None if value is None else float(value)


def turned(direction: Value, angle_deg: float) -> Value:
    """Rotate fibres towards the skin's normal by an angle, in the plane of fibre and normal.

    >>> np.round(turned((0.0, 1.0, 0.0), 30.0), 3)
    array([0.   , 0.866, 0.5  ])
    """
    axes = np.atleast_2d(direction.values if isinstance(direction, ElementMap) else np.asarray(direction))
    about = np.cross(axes, [0.0, 0.0, 1.0])
    size = np.linalg.norm(about, axis=1, keepdims=True)
    about = np.where(size > _LEAST_IN_SKIN, about / np.maximum(size, _LEAST_IN_SKIN), [1.0, 0.0, 0.0])
    moved = Rotation.from_rotvec(np.radians(angle_deg) * about).apply(axes)
    if isinstance(direction, ElementMap):
        return ElementMap(f"{direction.name}_turned", direction.block, moved)
    return float(moved[0, 0]), float(moved[0, 1]), float(moved[0, 2])


def write_direction_uncertainty(
    curve_along: Callable[[Value], LawCurve], direction: Value, shape: Array, deviation_deg: float,
    writer: StageWriter, *, site: str,
) -> None:  # fmt: skip
    """Write `direction_uncertainty` of fit-joint.json: change of force and speed by fibres turned by one
    standard deviation from `direction`; curve_along : the site's curve with its fibres in a direction."""
    values = []
    for angle in (0.0, deviation_deg):
        curve = curve_along(turned(direction, angle))
        try:
            values.append(curve(shape).values)
        except SolveError as error:
            writer.warnings.append(f"{site}: fibres {angle:.1f} deg off were not tried: {error.what}")
            return
        finally:
            curve.close()
    force, speed = np.split(values[1] / values[0] - 1.0, 2)
    worst = {"force_change_fraction": float(force[np.abs(force).argmax()]),
             "speed_change_fraction": float(speed[np.abs(speed).argmax()])}  # fmt: skip
    writer.data.setdefault("direction_uncertainty", {})[site] = {"deviation_deg": deviation_deg, **worst}
    by_force, by_speed = (100 * each for each in worst.values())
    writer.summary.append(
        f"{site}: fibres {deviation_deg:.1f} deg further out of the skin change the force by up to "
        f"{by_force:+.1f} %, speeds by {by_speed:+.1f} %"
    )
    if max(map(abs, worst.values())) > _MATTERS:
        writer.warnings.append(
            f"{site}: the fibres' direction is uncertain by {deviation_deg:.1f} deg, which matters here "
            "(direction_uncertainty) and is not included in the intervals; measure it more precisely, or in "
            "a second image"
        )


_ALIKE = 0.25  # difference of shares along fibres below which two images have the same orientation
_ACROSS, _ALONG = 0.25, 0.75


def share_along(model: LimbModel) -> float:
    """Share of the fibres' shear stiffness in the image's wave speed: f_x^2 + f_z^2 (0 across, 1 along)."""
    axis = mean_fibre(model)
    return float(axis[0] ** 2 + axis[2] ** 2)


def mean_fibre(model: LimbModel) -> Array:
    """The fibres' mean axis (3,), a unit vector."""
    direction = fibre_direction(model)
    axes = direction.values if isinstance(direction, ElementMap) else np.array([direction], dtype=float)
    return mean_axis(axes)[0]


def write_orientations(
    models: Sequence[tuple[str, LimbModel]], has_speeds: Sequence[bool], writer: StageWriter
) -> None:
    """Write `orientations` of fit-joint.json, and warnings about what those with and without speeds cannot
    determine; models : site name and model"""
    shares = {name: share_along(model) for name, model in models}
    writer.data["orientations"] = {
        name: {
            "fibre_to_image_deg": float(np.degrees(np.arccos(min(1.0, np.sqrt(share))))),
            "share_along": share,
            "fibres_told": model.fibres is not None,
            "has_speeds": seen,
        }
        for (name, model), share, seen in zip(models, shares.values(), has_speeds, strict=True)
    }
    listed = ", ".join(f"{name} {np.degrees(np.arccos(np.sqrt(s))):.0f} deg" for name, s in shares.items())
    writer.summary.append(f"fibres to the image plane: {listed}")
    for name, model in models:
        if model.fibres is None:
            writer.warnings.append(
                f"no fibre direction is given for site {name}: along the limb, within the skin, is assumed"
            )
    writer.warnings.extend(undetermined(list(shares.values()), has_speeds))


def undetermined(shares: Sequence[float], has_speeds: Sequence[bool]) -> list[str]:
    """Sentences on what measurements in these orientations cannot determine.

    >>> undetermined([0.0, 1.0], [True, True])
    []
    >>> print(undetermined([0.0], [True])[0][:59])
    all records are across the fibres: their speeds determine c
    """
    seen = [share for share, speeds in zip(shares, has_speeds, strict=True) if speeds]
    if max(shares) - min(shares) >= _ALIKE:
        if len(seen) < 2 or max(seen) - min(seen) < _ALIKE:
            return [
                "shear-wave speeds were read in one orientation only: fibre_shear is determined by "
                "forces; also read the speeds in the other orientation"
            ]
        return []
    share = float(np.mean(shares))
    turn = "also measure with the probe turned by 90 degrees"
    if share < _ACROSS:
        return [
            "all records are across the fibres: their speeds determine c, but the extra stiffness "
            f"along the fibres is determined by the force alone, where m and the mesh have the same effect; "
            f"{turn}"
        ]
    if share > _ALONG:
        return [
            "all records are along the fibres: their speeds determine only the product c (1 + fibre_shear); "
            f"a softer c with stiffer fibres fits equally well; {turn}"
        ]
    return [
        f"all records are of one orientation: only a combination of c and fibre_shear is determined; {turn}"
    ]


def write_moduli(c_kpa: float, fibre_shear: float, writer: StageWriter) -> list[str]:
    """Write the shear moduli along and across the fibres, as reported in elastography; a line on them."""
    across = c_kpa / 2
    along = across * (1 + fibre_shear)
    writer.data["mu_across_kpa"], writer.data["mu_along_kpa"] = across, along
    return [f"shear modulus across the fibres {across:.2f} kPa, along them {along:.2f} kPa"]


_SHEAR, _TENSION = 1, 2  # indices of fibre_shear and fibre_tension in the shape
_BEAM_AND_SIDE = [2, 1]  # axes z, y: polarisations of waves along x


def rest_speed(model: LimbModel, law: FitLaw, *, c: float, density_kg_per_m3: float) -> RestSpeed:
    """Function: shape -> ln of the mean speed (m/s) over the scanner's window at rest, and d / d ln shape.

    For propagation along x and polarisation along z, rho v^2 = c (1/2 + (s/2) (f_x^2 + f_z^2) +
    4 t f_x^2 f_z^2), where f is the fibre direction, s is fibre_shear and t is fibre_tension.

    Raises MeasurementError if the window contains no tissue.
    """
    items = next(each.items for each in model.records if each.kind == "element")
    blocks, points = model.mesh.blocks, model.mesh.points
    solid = np.flatnonzero(np.concatenate([np.full(len(each.cells), each.is_solid) for each in blocks]))
    numbers = solid if items is None else np.asarray(items, dtype=np.int64)
    rest = np.concatenate([points[each.cells[:, :4]].mean(axis=1) for each in blocks])[numbers]
    averages = pixel_averages(rest, MEAN_WINDOW.pixels(), face_height=0.0, window=MEAN_WINDOW)
    if not averages.inside.any():
        raise MeasurementError(
            "the scanner's window contains no tissue of the model",
            where="shear-wave prediction at rest",
            fix="check the site's position and mesh",
        )
    weights = np.zeros(len(rest))
    np.add.at(weights, averages.index, averages.weight / len(averages.index))
    used = np.flatnonzero(weights)
    tensors, weight = _alike_together(_tensors_at_rest(model, law, numbers[used], c), weights[used])

    def at(shape: Array) -> tuple[float, Array]:
        factors = np.r_[1.0, shape[_SHEAR], shape[_TENSION]]
        values, vectors = np.linalg.eigh(np.einsum("k,knij->nij", factors, tensors))
        mode = np.abs(vectors[:, 0, :]).argmax(axis=1)  # the mode polarised most along the beam
        a = np.take_along_axis(vectors, mode[:, None, None], axis=2)[:, :, 0]
        modulus = np.take_along_axis(values, mode[:, None], axis=1)[:, 0]
        speed = weight * np.sqrt(modulus)
        rates = 0.5 * np.einsum("ni,knij,nj->kn", a, tensors[1:], a) / modulus @ speed / speed.sum()
        slopes = np.zeros(len(shape))
        slopes[[_SHEAR, _TENSION]] = rates * factors[1:]
        return float(np.log(speed.sum() * np.sqrt(1.0 / mpa_from_pa(density_kg_per_m3)))), slopes

    return at


def _tensors_at_rest(model: LimbModel, law: FitLaw, items: IntArray, c: float) -> Array:
    """Parts (3, n, 2, 2), MPa, of the acoustic tensor at rest for waves along x, in the axes z, y: the first,
    that times fibre_shear, and that times fibre_tension. items : solid cells, numbered over all blocks"""
    names, counts = zip(*((each.name, len(each.cells)) for each in model.mesh.blocks), strict=True)
    place = names.index(next(each.block for each in model.domains if each.material == TISSUE))
    first, n_cells = sum(counts[:place]), counts[place]
    cells, F = items - first, np.broadcast_to(np.eye(3), (len(items), 3, 3))
    m = law.shape[0].start

    def at(shear: float, tension: float) -> Array:
        material = law.material(c, np.array([m, shear, tension]))
        Q = acoustic_tensor(material, F, np.array([1.0, 0.0, 0.0]), cells=cells, n_cells=n_cells)
        return np.asarray(Q[:, _BEAM_AND_SIDE][:, :, _BEAM_AND_SIDE])

    both = at(1.0, 1.0)
    by_shear, by_tension = at(2.0, 1.0) - both, at(1.0, 2.0) - both
    return np.stack([both - by_shear - by_tension, by_shear, by_tension])


def _alike_together(tensors: Array, weights: Array) -> tuple[Array, Array]:
    """Merge cells whose tensors agree to nine digits, adding their weights."""
    scale = float(np.abs(tensors).max())
    keys = np.round(np.moveaxis(tensors, 1, 0).reshape(len(weights), -1) / scale, 9)
    _, first, member = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    return tensors[:, first], np.bincount(member.ravel(), weights=weights).astype(np.float64)
