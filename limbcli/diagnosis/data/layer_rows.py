"""Layers as a channel of the diagnosis: rows, slopes, noise, and the material lines of a model.

A datum is the thickness of a layer at a level under load; the layer on the bone is left out, as it adds no
information to the depth. The models track the layers' borders as material lines, placed where they were read
at first touch.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from limbcli.diagnosis.data.rows import LAYER, SiteRows
from limbcli.diagnosis.explanations.noise import NoisePart, common
from limbcli.effects.curves import Curves
from limbcli.effects.effect import Effect, Theta
from limbcli.effects.reading import Protocol
from limbcli.effects.stiffness_places import Places
from limbcli.model import Array, IntArray, LimbModel, LogRecord
from limbcli.site_model.indentation_model import tissue_nodes
from limbcli.site_model.layer_readings import LayerReadings
from limbcli.solvers.material_lines import FILE, material_lines
from limbcli.solvers.solver import Simulation

FIRST_TOUCH = "measurement: layers at first touch"
# Standard deviation of a thickness from the model error: fractions of the layer's thinning and of the depth.
# On a block 16 mm thick, indented by 4 mm, tet10 meshes with edges of 5 to 9 mm and of 3 to 6 mm differ by
# 0.07 mm for a border 1.5 mm below the skin at rest, and by 0.02 to 0.06 mm for borders at 4 to 10 mm.
_OF_THINNING, _OF_DEPTH = 0.05, 0.02
_LEAST_LINE = 1e-3  # mm, smallest depth of a line below the skin
_SAMPLES = 240  # number of sampling points along the beam
_LEFT = 0.03  # smallest depth of a line under load, as a fraction of its depth at rest
_BEYOND = 2.0  # length of the compressed column where no bone is known, as a multiple of the deepest border


def layer_slopes(
    layers: LayerReadings | None, protocol: Protocol, place: Array, rows: SiteRows, y: Array
) -> Array:
    """Derivative of each datum with depth (n,), 0 for other channels.

    place (n_levels,) : ln(1 + F/unit) of the smooth depth, in which layers thin linearly
    """
    out = np.zeros(len(rows))
    for layer, members in _members(rows):
        assert layers is not None
        levels = rows.level[members]
        x = np.r_[0.0, place[levels]]
        depth = np.r_[0.0, np.maximum(protocol.depth[levels], 0.0)]
        thickness = np.r_[layers.thickness[0, layer], y[members]]
        span = float(x @ x)
        if span <= 0:
            continue
        rate, thinning = float(x @ depth) / span, float(x @ (thickness - thickness[0])) / span
        out[members] = thinning / rate if rate > 0 else 0.0
    return out


def layer_noise(
    layers: LayerReadings | None, protocol: Protocol, rows: SiteRows, y: Array, source: str
) -> list[NoisePart]:
    """Common errors of the readings of one layer: of its thickness at first touch, and of the model."""
    parts = []
    for layer, members in _members(rows):
        assert layers is not None
        first, model = np.zeros(len(rows)), np.zeros(len(rows))
        first[members] = layers.deviation * layers.growth(np.maximum(y[members], 0.0), layer)
        thinner = layers.thickness[0, layer] - y[members]
        depth = np.maximum(protocol.depth[rows.level[members]], 0.0)
        model[members] = np.hypot(_OF_THINNING * thinner, _OF_DEPTH * depth)
        name = layers.names[layer]
        parts.append(common(f"{FIRST_TOUCH}, {name}", first, source=source))
        parts.append(common(f"model: layers, {name}", model, source="assumed"))
    return parts


def _members(rows: SiteRows) -> list[tuple[int, IntArray]]:
    """Indices of the data of each layer."""
    mine = rows.among(LAYER)
    return [(k, np.flatnonzero(mine & (rows.part == k))) for k in np.unique(rows.part[mine]).tolist()]


class BorderLines:
    """The borders of a site's layers in its models.

    rest (n_borders,) : mm below the skin at first touch, without the border at the bone
    """

    def __init__(self, layers: LayerReadings):
        self.layers = layers
        self.rest = np.asarray(layers.rest[: layers.n_counted])

    def record(self, model: LimbModel) -> LogRecord:
        """Required output of a simulation: all tissue nodes, as effects may move the mesh under the beam."""
        return LogRecord("node", ("ux", "uy", "uz"), FILE, tissue_nodes(model))

    def check(self, model: LimbModel) -> None:
        """
        Raises
        ------
        MeasurementError
            If a border does not lie in the model's tissue.
        """
        material_lines(model, self.rest)

    def log_depths(self, model: LimbModel, simulation: Simulation, rows: IntArray) -> Array:
        """ln of the depth in mm below the skin (1 + n_rows, n_borders), at rest first."""
        lines = material_lines(model, self.rest)
        below = lines.below_skin(lines.of_table(simulation.nodes[FILE])[rows][..., 2])
        return np.log(np.maximum(np.vstack([self.rest, below]), _LEAST_LINE))


def line_shift(model: LimbModel, curves: Curves, ingredients: Sequence[tuple[Effect, Theta]]) -> Array:
    """Approximate change of the lines' ln depths (n, n_lines) by effects, without a simulation.

    Below the probe's centre the layers bear nearly the same pressure, like springs in series: tissue softer
    by a factor is compressed more by that factor, and the probe's depth is redistributed accordingly. Effects
    that are not a stiffness field do not move the lines. Simulations at one size and at the fitted size
    correct the error of this estimate (`forward_model.changes`, `SiteCurves.repair`).

    Source: springs in series as a model of layered tissue under a probe, Neumann et al. 2023, PLOS One
    18(4):e0284721.
    """
    assert curves.log_line is not None
    below = np.exp(curves.log_line)
    found = [each for each in ingredients if each[0].stiffness is not None]
    if not found:
        return np.zeros_like(below)
    rest = below[0]
    end = curves.thickness if curves.thickness > rest[-1] else _BEYOND * rest[-1]
    z = (np.arange(_SAMPLES) + 0.5) / _SAMPLES * end
    places = Places(np.column_stack([np.zeros((_SAMPLES, 2)), -z]), model)
    softer = np.ones(_SAMPLES)
    for effect, theta in found:
        assert effect.stiffness is not None
        softer = softer / np.maximum(effect.stiffness(places, theta), 1e-6)
    knots = np.r_[0.0, rest, end]
    lost = np.column_stack([np.zeros(len(below)), rest - below, curves.depth])
    of_part = np.searchsorted(knots, z, side="right") - 1
    rates = np.diff(lost, axis=1) / np.diff(knots)
    squeezed = np.maximum(rates[:, of_part], 0.0)

    def left(weight: Array) -> Array:
        """Depths (n, n_lines) of the lines in mm for this relative compression at each sampling point."""
        lost = np.cumsum(weight, axis=1) / np.maximum(weight.sum(axis=1, keepdims=True), 1e-12)
        share = np.array([np.interp(rest, z + 0.5 * end / _SAMPLES, row) for row in lost])
        return np.maximum(rest - curves.depth[:, None] * share, _LEFT * rest)

    return np.asarray(np.log(left(squeezed * softer) / left(squeezed)))
