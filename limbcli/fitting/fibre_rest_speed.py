"""fit with fibres: shear-wave speed in unloaded tissue, in the plane of each image."""

from __future__ import annotations

import numpy as np

from limbcli.effects.tissue import TISSUE
from limbcli.errors import MeasurementError
from limbcli.fitting.laws import FitLaw
from limbcli.inference.site_depth import RestSpeed
from limbcli.model import Array, IntArray, LimbModel
from limbcli.numbers.units import mpa_from_pa
from limbcli.shear_waves.any_law import acoustic_tensor
from limbcli.shear_waves.from_simulation import MEAN_WINDOW
from limbcli.shear_waves.pixels import pixel_averages

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
    """Three parts (3, n, 2, 2), MPa, of the acoustic tensor Q at rest for waves along x, in the axes z, y.

    Q is the sum of the first, fibre_shear times the second and fibre_tension times the third.
    items : solid cells, numbered over all blocks
    """
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
