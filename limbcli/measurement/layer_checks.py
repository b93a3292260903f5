"""Check readings of the layers for consistency: skin, fat and muscle along the beam, level by level.

Each fault has its own message. How far readings may differ by chance is determined by their noise; if that is
not known, only impossible readings are refused.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from limbcli.errors.problems import Problem
from limbcli.measurement.levels import LAYERS, Levels
from limbcli.measurement.number_table import problem
from limbcli.measurement.speed_noise import SpeedNoise
from limbcli.model import Array

# mm, standard deviation of a thickness marked on a B-mode image; edges are marked within 0.1 to 0.2 mm
USUAL_DEVIATION = 0.2
# standard deviations beyond chance: with fifty readings, one in a thousand data sets is refused by chance
_BEYOND_CHANCE = 4.0
_LEAST = 1.0  # mm by which columns of different origin may differ, whatever the noise


@dataclass(frozen=True)
class LayerNoise:
    """Standard deviations (mm) of a layer's thickness and of the depth, and those of the speeds."""

    thickness: float = USUAL_DEVIATION
    depth: float = 0.3
    speed: SpeedNoise = field(default_factory=SpeedNoise)


def check_layers(
    levels: Levels, path: Path, *, lines: list[int], noise: LayerNoise | None = None
) -> list[Problem]:
    """Every fault in the layers' columns, with its line.

    lines : line numbers in the file, one per level
    noise : None if unknown: growth under load is then not checked
    """
    if not levels.layers:
        return []
    found: list[Problem] = []
    checks: list[Callable[[Levels, Path, list[int], LayerNoise | None], list[Problem]]]
    checks = [_without_skin, _crossing, _sum_against_bone, _growing, _first_touch]
    for check in checks:
        found += check(levels, path, lines, noise)
    return found


def _without_skin(levels: Levels, path: Path, lines: list[int], _: LayerNoise | None) -> list[Problem]:
    """Fat and muscle begin where the skin ends, so skin must be given."""
    skin = levels.layer("skin")
    below = [name for name in LAYERS[1:] if name in levels.layers]
    other = np.any([np.isfinite(levels.layers[name]) for name in below], axis=0) if below else np.array([])
    fix = "add skin_mm (the thickness above the fat, even if the skin is hard to distinguish from it)"
    if below and not np.isfinite(skin).any():
        names = " and ".join(f"{name}_mm" for name in below)
        return [problem(f"there are layers without skin: {names}, but no skin_mm", path, fix)]
    return [
        problem("the level has layers below the skin but no skin_mm", path, fix, line=lines[k])
        for k in np.flatnonzero(np.isnan(skin) & other if below else [])
    ]


def _crossing(levels: Levels, path: Path, lines: list[int], _: LayerNoise | None) -> list[Problem]:
    """The lower interface of a layer must lie below its upper one, and above the bone."""
    found = []
    for name, values in levels.layers.items():
        for k in np.flatnonzero(values <= 0):
            what = f"interfaces cross: {name}_mm is {values[k]:g}, so the {name} ends above where it begins"
            fix = "mark the interfaces in order; leave the cell empty where a layer is not visible"
            found.append(problem(what, path, fix, line=lines[k]))
    if "muscle" in levels.layers:
        return found
    above = _total(levels)
    for k in np.flatnonzero(above > levels.skin_bone + _LEAST):
        what = f"interfaces cross: the layers end {above[k]:g} mm below the skin, "
        what += f"beyond the bone at {levels.skin_bone[k]:g} mm"
        found.append(problem(what, path, "mark the interfaces and the bone on the same image", line=lines[k]))
    return found


def _sum_against_bone(
    levels: Levels, path: Path, lines: list[int], noise: LayerNoise | None
) -> list[Problem]:
    """If muscle is measured, the layers must add up to the distance from skin to bone."""
    if "muscle" not in levels.layers:
        return []
    noise, total = noise or LayerNoise(), _total(levels)
    chance = noise.thickness * np.sqrt(len(levels.layers))
    allowed = max(_LEAST, _BEYOND_CHANCE * float(np.hypot(chance, noise.thickness)))
    found = []
    for k in np.flatnonzero(np.abs(total - levels.skin_bone) > allowed):
        what = f"the layers do not add up to the thickness: {_sum_words(levels, int(k))}, "
        what += f"but skin_bone_mm is {levels.skin_bone[k]:g}"
        fix = "read layers and bone on one image; muscle_mm extends to the bone"
        found.append(problem(what, path, fix, line=lines[k]))
    if np.isfinite(levels.skin_bone).any() or not np.isfinite(total[0]):
        return found
    allowed = max(_LEAST, _BEYOND_CHANCE * float(np.hypot(np.sqrt(2) * chance, noise.depth)))
    off = total[0] - levels.depth - total
    for k in np.flatnonzero(np.abs(off) > allowed):
        what = f"the layers do not add up to the thickness: {_sum_words(levels, int(k))}, but "
        what += (
            f"{total[0]:g} mm at the first level minus depth_mm leaves {total[0] - levels.depth[k]:.3g} mm"
        )
        fix = "depth_mm is the decrease in skin-bone distance since level 0, muscle_mm extends to the bone"
        found.append(problem(what, path, fix, line=lines[k]))
    return found


def _growing(levels: Levels, path: Path, lines: list[int], noise: LayerNoise | None) -> list[Problem]:
    """A layer must become thinner under a probe that presses on it."""
    if noise is None:
        return []
    allowed = _BEYOND_CHANCE * np.sqrt(2) * noise.thickness
    found = []
    for name, values in levels.layers.items():
        for k in np.flatnonzero((values - values[0] > max(allowed, 1e-9)) & levels.loading):
            what = f"the {name} grows under load, from {values[0]:g} to {values[k]:g} mm; layer_mm of "
            what += f"[site.noise] allows {allowed:.2g} mm"
            fix = "check the marks of this level; state a larger layer_mm if the edges are that hard to see"
            found.append(problem(what, path, fix, line=lines[k]))
    return found


def _first_touch(levels: Levels, path: Path, lines: list[int], _: LayerNoise | None) -> list[Problem]:
    """The thickness at first touch is required: deformation of layers is measured from it."""
    lacking = [name for name, values in levels.layers.items() if not np.isfinite(values[0])]
    if not lacking and levels.begins_at_zero:
        return []
    names = ", ".join(f"{name}_mm" for name in lacking or levels.layers)
    what = f"there is no reading of {names} at first touch; they are shown, but not used"
    return [problem(what, path, "read the layers on the image of level 0", line=lines[0], warning=True)]


def _total(levels: Levels) -> Array:
    """Sum (n_levels,) of all layers measured at any level; NaN where one of them is missing."""
    return np.asarray(np.sum(list(levels.layers.values()), axis=0))


def _sum_words(levels: Levels, k: int) -> str:
    parts = " + ".join(f"{each[k]:g}" for each in levels.layers.values())
    return f"{parts} = {float(_total(levels)[k]):.4g} mm"
