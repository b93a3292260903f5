"""Forces and wave speeds of a site's model in any state, as functions of the law's shape and stretches."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from limbcli.effects.tissue import fibre_direction
from limbcli.errors import SolveError
from limbcli.fitting.fibres import mean_fibre
from limbcli.fitting.laws import FitLaw
from limbcli.inference.monotone_interpolation import pchip_sample
from limbcli.inference.prediction import Prediction
from limbcli.model import Array, LimbModel, Material
from limbcli.numbers.units import mpa_from_pa
from limbcli.progress import SILENT, Progress
from limbcli.shear_waves import ogden
from limbcli.shear_waves.from_simulation import mean_speeds
from limbcli.shear_waves.speed import material_speeds
from limbcli.site_model.indentation_model import TISSUE, softer_jumps
from limbcli.site_model.prestretch import (
    WAYS,
    StretchAxes,
    prestretched,
    skin_rise,
    through_depths,
    with_layers_stretched,
)
from limbcli.site_model.site_layers import held_layers
from limbcli.solvers.session import ReferenceSession
from limbcli.solvers.session_parameters import Parameter

_NODES = "nodes.csv"
_STEP = 1e-4  # finite-difference step in ln of a stretch or of a parameter of the law
_NO_WAVE = 1e-3  # m/s, speed reported where no wave can propagate
_ALIGNED = 1e-6
# Additional simulated depth beyond the last, mm and as a fraction of that depth, because the skin may recede
# when stretched.
_BEYOND, _BEYOND_SHARE = 0.5, 0.1
_FURTHEST = 0.7  # least depth from first touch that must be simulated, as a fraction of the last depth
_CLEAR = 0.05  # mm from first touch, below which simulated levels are left out


class StateCurve:
    """The simulated curve of all states: of theta = (the law's shape, then the stretch of each of `ways`).

    Values are the forces (n_levels,) N at `depths` mm from first touch in that state, then the speeds
    (n_levels,) and the speed at rest (1,), both over that in evenly stretched tissue (`even_speed`). Forces
    have exact derivatives, speeds none. With layers of fixed stiffness the shape is that of
    `law.beside_layers()`.
    """

    def __init__(
        self, model: LimbModel, law: FitLaw, ways: Sequence[str], depths: Sequence[float], *, c: float,
        density_kg_per_m3: float, progress: Progress = SILENT,
    ):  # fmt: skip
        self.axes, self.ways, self.depths = StretchAxes.of(model), tuple(ways), np.array(depths, dtype=float)
        self._model = through_depths(model, [*depths, (1.0 + _BEYOND_SHARE) * depths[-1] + _BEYOND])
        self._stretched = (TISSUE, *held_layers(model))
        self.law, self.c, self._density = law.along(fibre_direction(model)), c, density_kg_per_m3
        x, y, z = mean_fibre(model)
        self._even = law.along((float(x), float(y), float(z)))
        # of each stretch direction from the image's lateral axis
        offsets = abs(self.axes.along[1]), abs(self.axes.around[1])
        self._aligned = int(np.argmin(offsets)) if min(offsets) < _ALIGNED else None
        self.n_shape, self.n_solves = len(law.shape), 0
        shape = np.array([each.start for each in law.shape])
        stretched = np.full((1, len(self.ways)), 1.1)
        self._felt = [
            k for k in range(len(shape))
            if self.even_speeds(_moved(shape, k, 0.1), stretched) != self.even_speeds(shape, stretched)
        ]  # fmt: skip
        first = self.in_state(self._model, np.r_[shape, np.ones(len(self.ways))], c=c)
        self._session = ReferenceSession(self._eased(first), progress=progress)

    def stretches(self, theta: Array) -> tuple[float, float]:
        """The stretches along and around the limb."""
        along, around = self._pairs(theta[None, self.n_shape :])[0]
        return float(along), float(around)

    def __call__(self, theta: Array, wrt: Sequence[int] = ()) -> Prediction:
        self.n_solves += 1
        theta = np.asarray(theta, dtype=float)
        searched = self.law.searched(self.c, theta[: self.n_shape])
        pulled = {
            (name, f"F0.{way}"): self._direction(theta, way) for way in self.ways for name in self._stretched
        }
        model = self.in_state(self._model, theta, c=self.c)
        result = self._session.solve(
            self._eased(model), wrt=[*((TISSUE, name) for name in searched), *pulled], weights=pulled,
            records=True, field_gradients=(_NODES,),
        )  # fmt: skip
        points = result.must_points
        rows = result.rows
        nodes = result.simulation.nodes[_NODES]
        moved = np.stack([nodes.column(name)[rows[0]] for name in ("ux", "uy", "uz")], axis=1)
        rise, weights = skin_rise(model, nodes.items, moved)
        lifted = {key: weights @ each[_NODES].column("uz")[0] for key, each in result.field_gradient.items()}
        faces = result.simulation.probe_depth().copy()
        faces[rows[0]] = -rise
        speeds = mean_speeds(
            model, result.simulation, rows, density_kg_per_m3=self._density, face_depths=faces
        )
        return self._from_touch(
            points.depths[1:] + rise, points.forces[1:], self._slopes(result.force_gradient, searched)[1:],
            self._slopes(lifted, searched)[0], speeds / np.exp(self.even_speed(theta)[0]),
        )  # fmt: skip

    def _from_touch(
        self, depths: Array, forces: Array, force_slopes: Array, rise_slopes: Array, speeds: Array
    ) -> Prediction:
        """Interpolate what was simulated at `depths` from first touch (n,) at those of the curve, linearly
        beyond the last. speeds (1 + n,) : at rest first; force_slopes (n, n_theta), rise_slopes (n_theta,)"""
        if depths[-1] < _FURTHEST * self.depths[-1]:
            raise SolveError(
                f"the stretched skin recedes so far that the probe ends {depths[-1]:.2f} mm below it; "
                f"{self.depths[-1]:.2f} mm are needed",
                where="reference solver, states",
                fix="check the stretches of the states; such compressibility is not plausible for tissue",
            )
        clear, at = depths > _CLEAR, np.minimum(self.depths, depths[-1])
        knots, beyond = np.r_[0.0, depths[clear]], self.depths - at
        force = pchip_sample(knots, np.r_[0.0, forces[clear]], at)
        values = force.values + force.slopes * beyond
        slopes = force.weights[:, 1:] @ force_slopes[clear] * (values / force.values)[:, None]
        slopes -= np.outer(force.slopes, rise_slopes)
        speed = pchip_sample(knots, np.r_[speeds[0], speeds[1:][clear]], at)
        unknown = np.full((len(at) + 1, slopes.shape[1]), np.nan)
        return Prediction(
            np.r_[values, speed.values + speed.slopes * beyond, speeds[0]], np.vstack([slopes, unknown])
        )

    def even_speed(self, theta: Array) -> tuple[float, Array]:
        """ln of the speed (m/s) at rest in uniformly stretched tissue, and d / d ln theta (n_theta,)."""
        shape, stretches = theta[: self.n_shape], theta[self.n_shape :]
        n, slopes = len(stretches), np.zeros(len(theta))
        moved = np.exp(_STEP * np.vstack([np.zeros(n), np.eye(n), -np.eye(n)]))
        shapes = [_moved(shape, k, step) for k in self._felt for step in (_STEP, -_STEP)]
        found = self._even_speeds((shape, stretches * moved), *((each, stretches[None]) for each in shapes))
        up, down = found[1 : 1 + n], found[1 + n : 1 + 2 * n]
        slopes[self.n_shape :] = (up - down) / (2 * _STEP)
        up, down = found[1 + 2 * n :].reshape(-1, 2).T
        slopes[list(self._felt)] = (up - down) / (2 * _STEP)
        return float(found[0]), slopes

    def even_speeds(self, shape: Array, stretches: Array) -> Array:
        """ln of the speed (n,) in uniformly stretched tissue at c0, for stretches (n, n_ways) of `ways`."""
        return self._even_speeds((np.asarray(shape), np.asarray(stretches)))

    def _even_speeds(self, *given: tuple[Array, Array]) -> Array:
        """The same (n,) for several shapes, each with stretches (n_each, n_ways), one after the other."""
        laws = [self._even.material(self.c, shape) for shape, _ in given]
        pairs = [self._pairs(stretches) for _, stretches in given]
        terms = [each for law in laws if (each := ogden.terms_of(law)) is not None]
        if len(terms) < len(laws) or self._aligned is None:
            return np.concatenate([self._by_tensor(*each) for each in zip(laws, pairs, strict=True)])
        row = np.repeat(np.arange(len(terms)), [len(each) for each in pairs])
        each_row = ogden.OgdenTerms(
            np.vstack([each.c for each in terms])[row], np.vstack([each.m for each in terms])[row]
        )
        both = np.concatenate(pairs)
        modulus = ogden.principal_modulus(each_row, both[:, self._aligned], 1.0 / (both[:, 0] * both[:, 1]))
        return np.asarray(0.5 * np.log(modulus / mpa_from_pa(self._density)))

    def _by_tensor(self, law: Material, pairs: Array) -> Array:
        """The same for one law, with the stretches along and around (n, 2), by the acoustic tensor."""
        F = np.array([self.axes.gradient(*each) for each in pairs])
        cells = np.zeros(len(F), dtype=np.int64)
        found = material_speeds(law, F, cells, n_cells=1, density_kg_per_m3=self._density)
        return np.asarray(np.log(np.nan_to_num(found, nan=_NO_WAVE)))

    def _pairs(self, stretches: Array) -> Array:
        """Stretches (n, 2) along and around, from those of `ways` (n, n_ways)."""
        pairs = np.ones((len(stretches), 2))
        pairs[:, [WAYS.index(way) for way in self.ways]] = stretches
        return pairs

    def in_state(self, model: LimbModel, theta: Array, *, c: float) -> LimbModel:
        """The model with the tissue of theta, and its layers stretched equally."""
        gradient = self.axes.gradient(*self.stretches(theta))
        return with_layers_stretched(model, gradient).with_material(TISSUE, self.tissue(theta, c=c))

    def tissue(self, theta: Array, *, c: float) -> Material:
        """The law of theta with its prestretch, at this c."""
        law = self.law.material(c, theta[: self.n_shape])
        return prestretched(law, self.axes.gradient(*self.stretches(theta)))

    def close(self) -> None:
        self._session.close()

    def _direction(self, theta: Array, way: str) -> Array:
        """d F_pre / d stretch (9,)."""
        along, around = self.stretches(theta)
        stretch = along if way == "along" else around
        return np.ravel(self.axes.slope(along, around, way)) / stretch

    def _slopes(self, found: Mapping[Parameter, Any], searched: Mapping[str, Array]) -> Array:
        """Derivatives by theta (n, n_theta), from those by material parameters and prestrain gradient."""
        by_shape = sum(np.outer(found[(TISSUE, name)], slope) for name, slope in searched.items())
        by_stretch = [
            np.atleast_1d(sum(found[(name, f"F0.{way}")] for name in self._stretched)) for way in self.ways
        ]
        return np.column_stack([np.asarray(by_shape), *by_stretch])

    def _eased(self, model: LimbModel) -> LimbModel:
        return softer_jumps(model) if self.law.has_fibres else model


def _moved(shape: Array, k: int, step: float) -> Array:
    """The shape with one parameter changed by a step of its logarithm."""
    out = np.array(shape, dtype=float)
    out[k] *= np.exp(step)
    return out
