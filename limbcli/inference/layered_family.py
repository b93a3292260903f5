"""Emulator of the layered slab: readings of an indentation for any thickness, layers and tissue, in
microseconds, from reference-solver results shipped with the package.

For each reading it is a polynomial of second or third degree in the family's coordinates and the strain,
whichever has the smaller cross-validation error, added to the trend of springs in series; it is fitted to the
solves' values and to their derivatives by the tissue. Its error is that of members left out.

The file of solves is made by tests/benchmarks/cohort_family.py with the reference solver (0.1.0) and the mesh
of `tests/benchmarks/layered_member.py`; its members are a scrambled Sobol sequence.
"""

from __future__ import annotations

import csv
import functools
import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

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
    """Rows of the solves: x (n, 6), readings y (n, 4) less the trend, slopes (n, 4, 2) by the tissue."""

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
    """Trend of the readings (..., n, 4), the layers as springs in series, and its derivative by ln ratio;
    shares (n, 3), log_ratio (..., n)."""
    soft = shares[:, 1] * np.exp(-log_ratio)
    whole = shares[:, 0] / SKIN_RATIO + soft + shares[:, 2]
    none = np.zeros_like(whole)
    part = np.log(shares[:, 2]) - np.log(shares[:, 1]) + log_ratio
    return (
        np.stack([-np.log(whole), none, part, none], axis=-1),
        np.stack([soft / whole, none, none + 1.0, none], axis=-1),
    )


_DEGREES, _CORRECTION_DEGREE = (2, 3), 1
_RIDGE = 1e-4  # ridge penalty per row, of terms above first degree
_SLOPE_WEIGHT = 0.5  # weight of the derivatives relative to the values
_FOLDS = 6  # folds of the cross-validation
_MESH, _FINE = "family", "fine"
_FEWEST_FINE = 6  # smallest number of members on the finer mesh for a correction by them


@dataclass(frozen=True, eq=False)
class LayeredFamily:
    """Fitted emulator: powers (n_terms, 6); coefficients (n_terms, 4); error (4,), one standard deviation of
    each reading.

    Readings: ln of force over (c_muscle, face, strain); ln of the slope of the secant over that of the line
    fitted from first contact; logit of muscle's fraction of the shortening of fat and muscle; skin's fraction
    of the total shortening.
    """

    powers: IntArray
    coefficients: Array
    error: Array
    n_members: int
    n_fine: int

    def __call__(self, x: Array) -> Array:
        """Readings (n, 4) at coordinates x (n, 6)."""
        x = np.clip(x, LOW, HIGH)
        return np.asarray(
            _terms(_scaled(x), self.powers) @ self.coefficients + trend(shares_of(x), x[:, RATIO])[0]
        )

    def of_shape(self, x: Array) -> OfTissue:
        """Readings as functions of the tissue alone, for rows of given shape and strain x (n, 6)."""
        x = np.clip(x, LOW, HIGH)
        u = _scaled(x)
        u[:, [RATIO, EXPONENT]] = 1.0
        weighted = _terms(u, self.powers)[:, :, None] * self.coefficients
        n = int(self.powers.max()) + 1
        out = np.zeros((len(x), n, n, self.coefficients.shape[1]))
        for term, (i, j) in enumerate(self.powers[:, [RATIO, EXPONENT]]):
            out[:, i, j] += weighted[:, term]
        return OfTissue(out, shares_of(x))


@dataclass(frozen=True, eq=False)
class OfTissue:
    """Readings of rows as functions of their tissue: a trend plus polynomials in scaled ln ratio and ln m.

    table : (n, degree + 1, degree + 1, 4)
    shares : (n, 3) of skin, fat and muscle
    """

    table: Array
    shares: Array

    def __call__(self, tissue: Array, *, slopes: bool = False) -> tuple[Array, Array]:
        """Readings (..., n, 4) at ln ratio and ln m (..., n, 2), and their derivatives (..., n, 4, 2).

        Beyond a limit of the family's range the value at the limit is used.
        """
        ends = [RATIO, EXPONENT]
        low, high = LOW[ends], HIGH[ends]
        inside = np.clip(tissue, low, high)
        u = 2.0 * (inside - low) / (high - low) - 1.0
        up = np.arange(self.table.shape[1])
        a, b = u[..., [0]] ** up, u[..., [1]] ** up
        middle, by_ratio = trend(self.shares, inside[..., 0])
        if not slopes:
            values = middle + self._polynomials((a, b))[..., 0, :]
            return values, np.empty((*values.shape, 0))
        rate = np.maximum(up - 1, 0)
        by_a, by_b = up * u[..., [0]] ** rate, up * u[..., [1]] ** rate
        found = self._polynomials((a, b), (by_a, b), (a, by_b))
        values, found = middle + found[..., 0, :], np.moveaxis(found[..., 1:, :], -2, -1)
        within = (tissue > low) & (tissue < high)
        found = found * (2.0 / (high - low))
        found[..., 0] += by_ratio
        return values, found * within[..., None, :]

    def _polynomials(self, *monomials: tuple[Array, Array]) -> Array:
        """Values (..., n, n_given, 4) at pairs of monomials (..., n, degree + 1) of ln ratio and of ln m."""
        pairs = np.stack([one[..., :, None] * other[..., None, :] for one, other in monomials], axis=-3)
        flat = self.table.reshape(len(self.table), -1, self.table.shape[-1])
        return np.asarray(pairs.reshape(*pairs.shape[:-2], -1) @ flat)


def is_inside(x: Array) -> NDArray[np.bool_]:
    """Coordinates (n, 6) within the family's range but for the tissue, which is not checked: (n,) bool."""
    own = [k for k in range(x.shape[1]) if k not in (RATIO, EXPONENT)]
    slack = 0.02 * (HIGH - LOW)
    return np.asarray(((x >= LOW - slack) & (x <= HIGH + slack))[:, own].all(axis=1))


@functools.cache
def layered_family() -> LayeredFamily:
    """Build the emulator from its file of solves. Raises ToolError if the file is missing or damaged."""
    solved = read_solved(FILE, _MESH)
    if len(set(solved.member.tolist())) < _FOLDS:
        raise ToolError(
            "the cohort's emulator has too few simulations",
            where=str(FILE),
            fix="install limbcli again: pip install --force-reinstall limbcli",
        )
    powers = _powers(max(_DEGREES))
    coefficients, error = np.zeros((len(powers), len(READINGS))), np.full(len(READINGS), np.inf)
    for degree in _DEGREES:
        low = powers.sum(axis=1) <= degree
        missed = _left_out(solved, powers[low])
        better = missed < error
        fitted = np.zeros_like(coefficients)
        fitted[low] = _fitted(solved, powers[low])
        coefficients[:, better], error[better] = fitted[:, better], missed[better]
    fine = read_solved(FILE, _FINE)
    n_fine = len(set(fine.member.tolist()))
    if n_fine >= _FEWEST_FINE:
        coefficients = coefficients + _correction(fine, powers, coefficients)
    return LayeredFamily(powers, coefficients, error, len(set(solved.member.tolist())), n_fine)


def _powers(degree: int) -> IntArray:
    terms = [
        each for each in itertools.product(range(degree + 1), repeat=len(COORDINATES)) if sum(each) <= degree
    ]
    return np.array(sorted(terms, key=lambda each: (sum(each), each)), dtype=np.int64)


def _scaled(x: Array) -> Array:
    return np.asarray(2.0 * (x - LOW) / (HIGH - LOW) - 1.0)


def _terms(u: Array, powers: IntArray, *, by: int | None = None) -> Array:
    """Monomials (n, n_terms) of scaled coordinates, or their derivatives by coordinate `by`."""
    highest = int(powers.max())
    table = u[:, :, None] ** np.arange(highest + 1)  # (n, 6, degree + 1)
    out = np.ones((len(u), len(powers)))
    for j in range(u.shape[1]):
        if by == j:
            p = powers[:, j]
            out *= p * table[:, j, np.maximum(p - 1, 0)]
        else:
            out *= table[:, j, powers[:, j]]
    return out


def _fitted(solved: SolvedMember, powers: IntArray) -> Array:
    """Coefficients (n_terms, 4) by least squares on values and derivatives."""
    u = _scaled(solved.x)
    blocks, targets = [_terms(u, powers)], [solved.y]
    for k, j in enumerate((RATIO, EXPONENT)):
        half = 0.5 * (HIGH[j] - LOW[j])
        blocks.append(_SLOPE_WEIGHT * _terms(u, powers, by=j))
        targets.append(_SLOPE_WEIGHT * half * solved.slopes[:, :, k])
    a, b = np.concatenate(blocks), np.concatenate(targets)
    known = np.isfinite(b).all(axis=1)
    a, b = a[known], b[known]
    grown = powers.sum(axis=1)
    ridge = np.diag(_RIDGE * len(solved.x) * (grown > 1))
    return np.asarray(np.linalg.solve(a.T @ a + ridge, a.T @ b))


def _left_out(solved: SolvedMember, powers: IntArray) -> Array:
    """Cross-validation error (4,): root mean square residual of the members left out of the fit."""
    numbers = np.unique(solved.member)
    missed = np.empty_like(solved.y)
    for fold in range(_FOLDS):
        out = np.isin(solved.member, numbers[fold::_FOLDS])
        kept = SolvedMember(solved.member[~out], solved.x[~out], solved.y[~out], solved.slopes[~out])
        missed[out] = solved.y[out] - _terms(_scaled(solved.x[out]), powers) @ _fitted(kept, powers)
    return np.asarray(np.sqrt(np.mean(missed**2, axis=0)))


def _correction(fine: SolvedMember, powers: IntArray, coefficients: Array) -> Array:
    """Correction (n_terms, 4) by a finer mesh: a plane through the residuals of its members."""
    low = powers.sum(axis=1) <= _CORRECTION_DEGREE
    missed = fine.y - _terms(_scaled(fine.x), powers) @ coefficients
    a = _terms(_scaled(fine.x), powers[low])
    ridge = 0.05 * len(fine.x) * np.diag((powers[low].sum(axis=1) > 0).astype(float))
    added = np.zeros_like(coefficients)
    added[low] = np.linalg.solve(a.T @ a + ridge, a.T @ missed)
    return added
