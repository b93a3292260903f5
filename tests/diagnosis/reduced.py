"""A reduced model of an indented layer: real laws and effects on a prescribed family of deformations.

A block of tetrahedra under a probe face; the probe's depth squeezes it by a known field (most
under the face, bulging along the short side), and forces follow from the stored energy. Not
a solution of equilibrium, but every effect of the law, its force and its speeds are the real
ones, in milliseconds.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from limbcli.case import StatedNoise
from limbcli.diagnosis.data.windows import Windows
from limbcli.effects.curves import Curves
from limbcli.effects.effect import applied
from limbcli.effects.frozen_deformation import SolvedDeformation, frozen_force, frozen_speed
from limbcli.effects.ingredients import stiffness_fields
from limbcli.effects.reading import Protocol as ReadProtocol
from limbcli.effects.reading import Reading, read
from limbcli.errors import SolveError
from limbcli.materials.ogden import ogden_type
from limbcli.measurement.indentation import Levels
from limbcli.model import Block, Domain, LimbModel, Mesh, Surface
from limbcli.solvers.integration_points import IntegrationPoints

HEIGHT = 25.0
_SHIFTS: dict[tuple, tuple[np.ndarray, np.ndarray]] = {}


def block_model(nx: int = 9, ny: int = 6, nz: int = 6, *, height: float = HEIGHT) -> LimbModel:
    """A box of tetrahedra 66 x 44 mm, six a cell; `skin` on top, `bone` below."""
    x, y, z = np.linspace(-33, 33, nx + 1), np.linspace(-22, 22, ny + 1), np.linspace(-height, 0, nz + 1)
    points = np.stack(np.meshgrid(x, y, z, indexing="ij"), axis=-1).reshape(-1, 3)
    number = np.arange(len(points)).reshape(nx + 1, ny + 1, nz + 1)
    corner = [
        number[i : i + nx, j : j + ny, k : k + nz].ravel() for i in (0, 1) for j in (0, 1) for k in (0, 1)
    ]
    paths = ((0, 1, 3, 7), (0, 3, 2, 7), (0, 2, 6, 7), (0, 6, 4, 7), (0, 4, 5, 7), (0, 5, 1, 7))
    cells = np.concatenate([np.stack([corner[c] for c in path], axis=1) for path in paths]).astype(np.int64)
    top = number[:, :, -1]
    a, b, c, d = top[:-1, :-1].ravel(), top[1:, :-1].ravel(), top[1:, 1:].ravel(), top[:-1, 1:].ravel()
    tri = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]).astype(np.int64)
    bone = number[:, :, 0].ravel().astype(np.int64)
    mesh = Mesh(
        points, (Block("tissue", "tet4", cells),), {"bone": bone, "fixed": bone},
        {"skin": Surface("skin", {"tri3": tri})},
    )  # fmt: skip
    return LimbModel(
        mesh, {"tissue": ogden_type(c=0.006, f_kappa=100.0, m=2.0)}, (Domain("tissue", "tissue"),)
    )


def kinematics(
    model: LimbModel, depth: np.ndarray, windows: Windows, *, spread: float = 1.0
) -> SolvedDeformation:
    """The prescribed deformation: squeezed under the face, tapering beside it and a little in the depth."""
    height = float(-model.mesh.points[:, 2].min())
    points = IntegrationPoints.of(model.mesh.points, model.mesh.block("tissue"))
    at = points.rest[:, 0]
    beside = np.exp(-((at[:, 0] / 30) ** 4) - (np.abs(at[:, 1]) / (12 * spread)) ** 3)
    shape = beside * (1.0 + 0.25 * (0.5 + at[:, 2] / height))
    gradients, seen = [], []
    for d in depth:
        x_z = np.log1p(-np.minimum(0.85 * shape * d / height, 0.9))
        F = np.zeros((len(at), 3, 3))
        F[:, 0, 0], F[:, 1, 1], F[:, 2, 2] = np.exp(-0.24 * x_z), np.exp(-0.76 * x_z), np.exp(x_z)
        F[:, 1, 2] = 0.25 * d / height * np.sin(np.pi * at[:, 1] / 22) * np.exp(-((at[:, 0] / 30) ** 4))
        gradients.append(F)
        places = at - np.outer((1 + at[:, 2] / height) * beside, [0, 0, d])
        seen.append(windows.seen(model, places, at, F, depth=float(d)))
    volume = np.abs(points.volume)
    return SolvedDeformation(depth, np.array(gradients)[:, :, None], points.rest, volume, tuple(seen))


@dataclass
class ReducedBook:
    """Simulations of a site by the reduced model."""

    model: LimbModel = field(default_factory=block_model)
    depth: np.ndarray = field(default_factory=lambda: np.linspace(0, 9, 7))
    c: float = 0.006
    spread: float = 1.0
    spent: bool = False
    windows: Windows = field(default_factory=Windows)
    _deformed: dict = field(default_factory=dict)
    _laws: dict = field(default_factory=dict)
    _without: dict = field(default_factory=dict)

    def _with(self, m: float, ingredients, *, waves: bool = False) -> LimbModel:
        model = self.model.with_material("tissue", ogden_type(c=self.c, f_kappa=100.0, m=m))
        return applied(model, ingredients, waves=waves)

    def _raw(self, m: float, ingredients) -> tuple[Curves, None]:
        for effect, _ in ingredients:
            if effect.name in ("tilt", "friction", "poroelasticity"):
                raise SolveError("the reduced model cannot move its probe", where="reduced model", fix="none")
        laws = tuple(each for each in ingredients if getattr(each[0], "stiffness", None) is None)
        model, in_window = self._plain(m), self._plain(m)
        if laws:
            model, in_window = self._with(m, laws), self._with(m, laws, waves=True)
        deformed = self._deformation(model)
        known = tuple(each for each in ingredients if each not in laws)
        force = frozen_force(model, deformed, stiffness_fields(known))
        force = np.maximum(force - force[0], 0.0)
        speed = frozen_speed(
            in_window, deformed, stiffness_fields(known, waves=True), density_kg_per_m3=1000.0
        )
        if laws:
            deformed.forget(model, in_window)
        height = float(-model.mesh.points[:, 2].min())
        return Curves(self.depth, force, speed, self.windows.depths, height)

    def _plain(self, m: float) -> LimbModel:
        if m not in self._laws:
            self._laws[m] = self._with(m, ())
        return self._laws[m]

    def _deformation(self, model: LimbModel) -> SolvedDeformation:
        """Of one mesh, kept: it is prescribed."""
        if id(model.mesh) not in self._deformed:
            found = kinematics(model, self.depth, self.windows, spread=self.spread)
            self._deformed[id(model.mesh)] = (model.mesh, found)
        return self._deformed[id(model.mesh)][1]

    def curves(self, m: float, ingredients=()) -> Curves:
        return self._raw(m, ingredients)

    def shift(self, m: float, ingredients) -> tuple[np.ndarray, np.ndarray]:
        """At m rounded to halves, and remembered: a change hardly depends on m, and is shared."""
        rounded = max(round(2 * m) / 2, 1.0)
        axes = tuple(self.model.info.get("patient_from_model", ()))
        key = (len(self.model.mesh.points), self.depth[-1], self.spread, rounded, axes)
        key += tuple((e.name, tuple(sorted(theta.items()))) for e, theta in ingredients)
        if key not in _SHIFTS:
            _SHIFTS[key] = self._shift(rounded, ingredients)
        return _SHIFTS[key]

    def _shift(self, m: float, ingredients) -> tuple[np.ndarray, np.ndarray]:
        if m not in self._without:
            self._without[m] = self._raw(m, ())
        changed, plain = self._raw(m, ingredients), self._without[m]
        ratio = np.log(np.maximum(changed.force[1:], 1e-9) / plain.force[1:])
        return np.concatenate([ratio[:1], ratio]), changed.log_speed - plain.log_speed


NOISE = StatedNoise(force=0.1, depth=0.15, swe_level_fraction=0.03, swe_pixel_fraction=0.1, source="repeats")


def truth(
    ingredients=(), reading: Reading | None = None, *, c: float = 0.0065, m: float = 4.0,
    simulations: ReducedBook | None = None, n_levels: int = 14, hold: float = 20.0,
):  # fmt: skip
    """The true curves, how they are read, and the protocol: a finer block, another spread."""
    simulations = simulations or ReducedBook(block_model(11, 8, 7), np.linspace(0, 10, 9), spread=1.03)
    curves = simulations.curves(m, ingredients)
    curves = replace(
        curves,
        force=curves.force * c / simulations.c,
        log_speed=curves.log_speed + 0.5 * np.log(c / simulations.c),
    )
    shown = np.linspace(0, 8.5, n_levels)
    protocol = ReadProtocol(np.zeros(n_levels), shown, np.full(n_levels, hold))
    return curves, reading or Reading(), protocol


def measured(
    rng: np.random.Generator, ingredients=(), reading: Reading | None = None, *, c: float = 0.0065,
    m: float = 4.0, noise: StatedNoise = NOISE, simulations: ReducedBook | None = None, n_levels: int = 14,
    understated: float = 1.0,
    hold: float = 20.0, onset: float = 0.0,
) -> Levels:  # fmt: skip
    """Levels as an instrument would write them: a finer block, another spread, noise of another law.

    onset : share of the levels before which the ingredients are not there
    """
    curves, true_reading, protocol = truth(
        ingredients, reading, c=c, m=m, simulations=simulations, n_levels=n_levels, hold=hold
    )
    shown, so = protocol.depth, read(curves, protocol, true_reading)
    if onset:
        of_tissue = truth((), reading, c=c, m=m, simulations=simulations, n_levels=n_levels, hold=hold)[0]
        plain = read(of_tissue, protocol, true_reading)
        early = np.arange(n_levels) < onset * n_levels
        so = replace(
            so, force=np.where(early, plain.force, so.force),
            log_speed=np.where(early[:, None], plain.log_speed, so.log_speed),
        )  # fmt: skip
    k = understated

    def laplace(sd):
        return k * sd * rng.laplace(size=n_levels) / np.sqrt(2)

    force = so.force + laplace(noise.force)
    depth = shown + laplace(noise.depth)
    gain = 1 + 0.02 * rng.standard_normal()
    speed = (
        np.exp(so.log_speed[:, 0]) * gain * (1 + k * noise.swe_level_fraction * rng.standard_normal(n_levels))
    )
    force[0], depth[0] = (0.0, 0.0) if reading is None else (force[0], 0.0)
    nan = np.full(n_levels, np.nan)
    return Levels(
        force=force, depth=depth, swe_mean_m_per_s=speed, swe_sd_m_per_s=nan,
        swe_pixels=np.full(n_levels, 500.0),
        phase=("load",) * n_levels,
        hold=np.full(n_levels, hold), probe_travel=nan, skin_bone=nan, path=Path("levels.csv"),
    )  # fmt: skip
