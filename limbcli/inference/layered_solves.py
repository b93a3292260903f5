"""The shipped solves of the layered slab: coordinates, readings and their derivatives, row by row.

`LayeredFamily` defines the readings; they are stored relative to a trend, that of springs in series. The file
is made by tests/benchmarks/cohort_family.py with limbcli's reference solver (0.1.0), with the model and mesh
of `tests/benchmarks/layered_member.py`; its members are a scrambled Sobol sequence.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from limbcli.errors import ToolError
from limbcli.inference.monotone_interpolation import Monotone
from limbcli.model import Array, IntArray

FILE = Path(__file__).with_name("layered_family.csv")
FORCE, CONVEXITY, MUSCLE_PART, SKIN_PART = range(4)
READINGS = ("force", "convexity", "muscle_part", "skin_part")
COORDINATES = ("thickness", "fat_share", "skin", "ratio", "m", "strain")
RATIO, EXPONENT = 3, 4  # places in COORDINATES
SKIN_RATIO = 5.0  # c_skin / c_muscle, fixed
# Range of each coordinate, with logarithms of thickness, ratio and m. Beyond it the nearest limit is used.
LOW = np.array([np.log(0.35), 0.015, 0.02, np.log(0.1), np.log(1.5), 0.03])
HIGH = np.array([np.log(4.2), 0.70, 0.14, np.log(15.0), np.log(12.0), 0.45])
_NUDGE = 1e-4  # finite-difference step in ln ratio or ln m


@dataclass(frozen=True, eq=False)
class SolvedMember:
    """Rows of the solves: coordinates x (n, 6), readings y (n, 4) minus the trend, slopes (n, 4, 2) by the
    tissue."""

    member: IntArray
    x: Array
    y: Array
    slopes: Array


def read_solved(path: Path, mesh: str) -> SolvedMember:
    """Coordinates and readings of the rows of one mesh ("family", "fine", "held-out family" ...)."""
    try:
        with path.open(newline="", encoding="utf-8") as stream:
            rows = [row for row in csv.DictReader(stream) if row["mesh"] == mesh]
        members: dict[int, list[Mapping[str, str]]] = {}
        for row in rows:
            members.setdefault(int(row["member"]), []).append(row)
        parts = [_member(number, each) for number, each in members.items() if len(each) > 1]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ToolError(
            f"the simulations behind the cohort's emulator cannot be read ({error})",
            where=str(path),
            fix="install limbcli again: pip install --force-reinstall limbcli",
        ) from error
    if not parts:
        return SolvedMember(np.zeros(0, np.int64), np.zeros((0, 6)), np.zeros((0, 4)), np.zeros((0, 4, 2)))
    return SolvedMember(*(np.concatenate(each) for each in zip(*parts, strict=True)))


def _member(number: int, rows: Sequence[Mapping[str, str]]) -> tuple[IntArray, Array, Array, Array]:
    """The rows of one member, one per strain, in the order of the file."""

    def column(name: str) -> Array:
        return np.array([float(row[name]) for row in rows])

    strain, force = column("strain"), column("force")
    shape = [np.log(column("thickness")), column("fat_share"), column("skin")]
    tissue = [np.log(column("ratio")), np.log(column("m"))]
    below_skin, below_fat = column("below_skin"), column("below_fat")
    part = below_fat / below_skin
    y = np.column_stack([np.log(force), _convexity(strain, force), np.log(part / (1 - part)), 1 - below_skin])
    slopes = np.empty((len(strain), 4, 2))
    for k, name in enumerate(("ratio", "m")):
        by_force, by_skin, by_fat = (column(f"{each}_by_{name}") for each in ("force", "skin", "fat"))
        slopes[:, FORCE, k] = by_force
        nudged = _convexity(strain, force * np.exp(_NUDGE * by_force))
        slopes[:, CONVEXITY, k] = (nudged - y[:, CONVEXITY]) / _NUDGE
        by_part = (by_fat - part * by_skin) / below_skin
        slopes[:, MUSCLE_PART, k] = by_part / (part * (1 - part))
        slopes[:, SKIN_PART, k] = -by_skin
    x = np.column_stack([*shape, *tissue, strain])
    middle, by_ratio = trend(shares_of(x), x[:, RATIO])
    y, slopes[:, :, 0] = y - middle, slopes[:, :, 0] - by_ratio
    return np.full(len(strain), number), x, y, slopes


def _convexity(strain: Array, force: Array) -> Array:
    """ln of the slope of the secant over that of the line fitted from first contact, up to each strain."""
    curve = Monotone.through(np.r_[0.0, strain], np.r_[0.0, force * strain])
    found = np.empty(len(strain))
    for k, end in enumerate(strain):
        at = np.linspace(0.0, end, 101)
        values = curve.read(at).values
        slope = np.sum(values * at) / np.sum(at * at)
        found[k] = np.log(force[k] / slope)
    return found


def shares_of(x: Array) -> Array:
    """Fractions (n, 3) of the thickness that are skin, fat and muscle."""
    skin = x[:, 2] / np.exp(x[:, 0])
    return np.column_stack([skin, (1 - skin) * x[:, 1], (1 - skin) * (1 - x[:, 1])])


def trend(shares: Array, log_ratio: Array) -> tuple[Array, Array]:
    """Trend of the readings (..., n, 4), the layers taken as springs in series, and its derivative by ln
    ratio.

    shares (n, 3), log_ratio (..., n). The polynomials represent the difference between the solves and this
    trend.
    """
    soft = shares[:, 1] * np.exp(-log_ratio)
    whole = shares[:, 0] / SKIN_RATIO + soft + shares[:, 2]
    none = np.zeros_like(whole)
    part = np.log(shares[:, 2]) - np.log(shares[:, 1]) + log_ratio
    return (
        np.stack([-np.log(whole), none, part, none], axis=-1),
        np.stack([soft / whole, none, none + 1.0, none], axis=-1),
    )
