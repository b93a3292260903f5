"""Positions of sites relative to the skin: on it, close enough to be moved onto it, or implausible."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from limbcli.errors.problems import Problem
from limbcli.meshing.frame import nearest_skin_point
from limbcli.meshing.surfaces import Triangles
from limbcli.model import Array

MOVED_MM = 3.0  # mm: a site farther from the skin than this is moved onto it with a warning
MOST_MOVED_MM = 5.0  # mm: a site farther than this is not the place that was measured
TURNED = np.array([-1.0, -1.0, 1.0])  # RAS to LPS and back


@dataclass(frozen=True)
class PlaceFault:
    """What is wrong with a position, its fix, whether it is still usable, and the nearest skin point."""

    what: str
    fix: str
    usable: bool
    nearest: tuple[float, float, float]
    distance: float


def place_fault(skin: Triangles, place: Array) -> PlaceFault | None:
    """How a position (3,) (mm, patient LPS) fails to lie on a skin; None if it does lie on it."""
    point, _, far = nearest_skin_point(skin, np.asarray(place, float))
    _, _, turned = nearest_skin_point(skin, TURNED * place)
    return judged(place, point, far, turned)


def judged(
    place: Array, nearest: Array, far: float, turned: float, *, most: float = MOST_MOVED_MM, about: str = ""
) -> PlaceFault | None:
    """The fault of a position, given its distance (mm) to the skin as it is and with x and y reversed.

    most : farther than this (mm) is an error
    about : a word before the nearest point, used where the skin is known only roughly

    >>> print(judged(np.array([9.0, 0, 0]), np.array([2.0, 0, 0]), 7.0, 30.0).fix)
    write position_mm = [2.0, 0.0, 0.0], the nearest point of the skin, if that is the intended site
    >>> print(judged(np.array([9.0, 50.0, 0]), np.array([9.0, 10.0, 0]), 40.0, 1.0).fix)
    write position_mm = [-9.0, -50.0, 0.0]: the same point in LPS
    """
    x, y, z = (float(each) for each in nearest)
    if far <= min(MOVED_MM, most):
        return None
    if far > most and turned <= most:
        what = (
            f"lies {far:.0f} mm from the skin; with the signs of x and y reversed it lies on the skin: RAS, "
            f"not LPS?"
        )
        fix = f"write position_mm = {triple(TURNED * place)}: the same point in LPS"
        return PlaceFault(what, fix, False, (x, y, z), far)
    there, here = triple(nearest), triple(place)
    what = f"lies {far:.1f} mm from the skin: {here} is given, {about}{there} is the skin's nearest point"
    if far <= most:
        return PlaceFault(f"{what}; it is moved there", _write(there), True, (x, y, z), far)
    return PlaceFault(what, _write(there), False, (x, y, z), far)


def _write(there: str) -> str:
    return f"write position_mm = {there}, the nearest point of the skin, if that is the intended site"


def place_problems(skin: Triangles, places: Mapping[str, Array], *, where: str) -> list[Problem]:
    """Problems of sites that do not lie on the skin: too far away, or moved onto it.

    places : (3,) mm, patient LPS, by the site's name
    """
    return [problem_of(name, each, where=where) for name, each in place_faults(skin, places).items()]


def place_faults(skin: Triangles, places: Mapping[str, Array]) -> dict[str, PlaceFault]:
    """The faults of the positions (3,) (mm, patient LPS) that have one, by the site's name."""
    found = {name: place_fault(skin, np.asarray(place, float)) for name, place in places.items()}
    return {name: each for name, each in found.items() if each is not None}


def problem_of(name: str, fault: PlaceFault, *, where: str) -> Problem:
    severity = "warning" if fault.usable else "error"
    return Problem(f"site {name} {fault.what}", where, fault.fix, severity=severity)  # type: ignore[arg-type]


def triple(point: Array) -> str:
    """A point as written in case.toml.

    >>> triple(np.array([1.0, -2.25, -0.001]))
    '[1.0, -2.2, 0.0]'
    """
    rounded = np.round(np.asarray(point, float), 1) + 0.0
    return "[" + ", ".join(f"{each:.1f}" for each in rounded) + "]"
