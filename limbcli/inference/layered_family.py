"""The emulator of the layered slab: readings of an indentation for any thickness, layers and tissue, in
microseconds, from solves of the reference solver that ship with the package.

Per reading a polynomial in the family's numbers and the strain, of second or third degree (whichever misses
left-out members less), over the trend that springs in series give. It is fitted to the solves' values and to
their exact derivatives by tissue. Its error is what it misses on members left out of the fit, told reading by
reading; held-out members of another sequence are the check of the tests.
"""

from __future__ import annotations

import csv
import functools
import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from limbcli.errors import ToolError
from limbcli.model import Array, IntArray
from limbcli.monotone import Monotone

FILE = Path(__file__).with_name("layered_family.csv")
FORCE, CONVEXITY, MUSCLE_PART, SKIN_PART = range(4)
READINGS = ("force", "convexity", "muscle_part", "skin_part")
COORDINATES = ("thickness", "fat_share", "skin", "ratio", "m", "strain")
RATIO, EXPONENT = 3, 4  # places in COORDINATES
SKIN_RATIO = 5.0  # c_skin / c_muscle, held
# Ends of every coordinate: logarithms of thickness, ratio and m. Beyond them the nearest end is taken.
LOW = np.array([np.log(0.35), 0.015, 0.02, np.log(0.1), np.log(1.5), 0.03])
HIGH = np.array([np.log(4.2), 0.70, 0.14, np.log(15.0), np.log(12.0), 0.45])
_DEGREES, _CORRECTION_DEGREE = (2, 3), 1
_RIDGE = 1e-4
_SLOPE_WEIGHT = 0.5
_FOLDS = 6
_NUDGE = 1e-4
_MESH, _FINE = "family", "fine"
_FEWEST_FINE = 6  # members on the finer mesh, from which on they correct the family


@dataclass(frozen=True, eq=False)
class Solved:
    """Rows of the solves: x (n, 6) coordinates, y (n, 4) over the trend, slopes (n, 4, 2) by the tissue."""

    member: IntArray
    x: Array
    y: Array
    slopes: Array


@dataclass(frozen=True, eq=False)
class LayeredFamily:
    """powers (n_terms, 6); coefficients (n_terms, 4); error (4,): one deviation of every reading.

    Readings: ln of force over (c_muscle, face, strain); ln of the secant over the slope of the line through
    first contact; logit of muscle's part of what fat and muscle shorten; skin's part of the whole shortening.
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
            _terms(_scaled(x), self.powers) @ self.coefficients + trend(_shares(x), x[:, RATIO])[0]
        )

    def of_shape(self, x: Array) -> OfTissue:
        """The readings of rows of given shape and strain, x (n, 6), as functions of their tissue alone."""
        x = np.clip(x, LOW, HIGH)
        u = _scaled(x)
        u[:, [RATIO, EXPONENT]] = 1.0
        weighted = _terms(u, self.powers)[:, :, None] * self.coefficients
        n = int(self.powers.max()) + 1
        out = np.zeros((len(x), n, n, self.coefficients.shape[1]))
        for term, (i, j) in enumerate(self.powers[:, [RATIO, EXPONENT]]):
            out[:, i, j] += weighted[:, term]
        return OfTissue(out, _shares(x))


@dataclass(frozen=True, eq=False)
class OfTissue:
    """Rows' readings: a trend over polynomials of scaled ln ratio and ln m.

    table (n, degree + 1, degree + 1, 4); shares (n, 3) of skin, fat, muscle
    """

    table: Array
    shares: Array

    def __call__(self, tissue: Array, *, slopes: bool = False) -> tuple[Array, Array]:
        """Readings (..., n, 4) at ln ratio and ln m (..., n, 2), and derivatives (..., n, 4, 2) by them.

        Beyond an end of the family the end's value stands.
        """
        ends = [RATIO, EXPONENT]
        low, high = LOW[ends], HIGH[ends]
        inside = np.clip(tissue, low, high)
        u = 2.0 * (inside - low) / (high - low) - 1.0
        up = np.arange(self.table.shape[1])
        a, b = u[..., [0]] ** up, u[..., [1]] ** up
        middle, by_ratio = trend(self.shares, inside[..., 0])
        values = middle + np.einsum("...ni,...nj,nijq->...nq", a, b, self.table, optimize=True)
        if not slopes:
            return values, np.empty((*values.shape, 0))
        rate = np.maximum(up - 1, 0)
        by_a, by_b = up * u[..., [0]] ** rate, up * u[..., [1]] ** rate
        found = np.stack(
            [
                np.einsum("...ni,...nj,nijq->...nq", by_a, b, self.table, optimize=True),
                np.einsum("...ni,...nj,nijq->...nq", a, by_b, self.table, optimize=True),
            ],
            axis=-1,
        )
        within = (tissue > low) & (tissue < high)
        found = found * (2.0 / (high - low))
        found[..., 0] += by_ratio
        return values, found * within[..., None, :]


def _shares(x: Array) -> Array:
    """Skin's, fat's and muscle's shares (n, 3) of the thickness."""
    skin = x[:, 2] / np.exp(x[:, 0])
    return np.column_stack([skin, (1 - skin) * x[:, 1], (1 - skin) * (1 - x[:, 1])])


def trend(shares: Array, log_ratio: Array) -> tuple[Array, Array]:
    """Layers as springs in series: what the polynomials are over. Readings (..., n, 4), and by ln ratio.

    shares (n, 3), log_ratio (..., n). The solves say by how much layers under a probe are no springs.
    """
    soft = shares[:, 1] * np.exp(-log_ratio)
    whole = shares[:, 0] / SKIN_RATIO + soft + shares[:, 2]
    none = np.zeros_like(whole)
    part = np.log(shares[:, 2]) - np.log(shares[:, 1]) + log_ratio
    return (
        np.stack([-np.log(whole), none, part, none], axis=-1),
        np.stack([soft / whole, none, none + 1.0, none], axis=-1),
    )


def is_inside(x: Array) -> Array:
    """Which coordinates (n, 6) lie within the family, whatever the tissue: (n,) bool."""
    own = [k for k in range(x.shape[1]) if k not in (RATIO, EXPONENT)]
    slack = 0.02 * (HIGH - LOW)
    return np.asarray(((x >= LOW - slack) & (x <= HIGH + slack))[:, own].all(axis=1))


@functools.cache
def layered_family(path: Path = FILE) -> LayeredFamily:
    """The emulator from its file of solves.

    Raises
    ------
    ToolError
        If the file is missing or damaged.
    """
    solved = read_solved(path, _MESH)
    if len(set(solved.member.tolist())) < _FOLDS:
        raise ToolError(
            "too few solves lie behind the cohort's emulator",
            where=str(path),
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
    fine = read_solved(path, _FINE)
    n_fine = len(set(fine.member.tolist()))
    if n_fine >= _FEWEST_FINE:
        coefficients = coefficients + _correction(fine, powers, coefficients)
    return LayeredFamily(powers, coefficients, error, len(set(solved.member.tolist())), n_fine)


def read_solved(path: Path, mesh: str) -> Solved:
    """The rows of one mesh ("family", "fine", "held-out family" ...) as coordinates and readings."""
    try:
        with path.open(newline="", encoding="utf-8") as stream:
            rows = [row for row in csv.DictReader(stream) if row["mesh"] == mesh]
        members: dict[int, list[Mapping[str, str]]] = {}
        for row in rows:
            members.setdefault(int(row["member"]), []).append(row)
        parts = [_member(number, each) for number, each in members.items() if len(each) > 1]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ToolError(
            f"the solves behind the cohort's emulator cannot be read ({error})",
            where=str(path),
            fix="install limbcli again: pip install --force-reinstall limbcli",
        ) from error
    if not parts:
        return Solved(np.zeros(0, np.int64), np.zeros((0, 6)), np.zeros((0, 4)), np.zeros((0, 4, 2)))
    return Solved(*(np.concatenate(each) for each in zip(*parts, strict=True)))


def _member(number: int, rows: Sequence[Mapping[str, str]]) -> tuple[IntArray, Array, Array, Array]:
    """One member's strains, in their order."""

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
    middle, by_ratio = trend(_shares(x), x[:, RATIO])
    y, slopes[:, :, 0] = y - middle, slopes[:, :, 0] - by_ratio
    return np.full(len(strain), number), x, y, slopes


def _convexity(strain: Array, force: Array) -> Array:
    """ln of the secant's slope over that of the line through first contact, up to every strain."""
    curve = Monotone.through(np.r_[0.0, strain], np.r_[0.0, force * strain])
    found = np.empty(len(strain))
    for k, end in enumerate(strain):
        at = np.linspace(0.0, end, 101)
        values = np.interp(at, [0.0, end], [0.0, 0.0]) + curve(at)
        slope = np.sum(values * at) / np.sum(at * at)
        found[k] = np.log(force[k] / slope)
    return found


def _powers(degree: int) -> IntArray:
    terms = [
        each for each in itertools.product(range(degree + 1), repeat=len(COORDINATES)) if sum(each) <= degree
    ]
    return np.array(sorted(terms, key=lambda each: (sum(each), each)), dtype=np.int64)


def _scaled(x: Array) -> Array:
    return np.asarray(2.0 * (x - LOW) / (HIGH - LOW) - 1.0)


def _terms(u: Array, powers: IntArray, *, by: int | None = None) -> Array:
    """Monomials (n, n_terms) of scaled coordinates, or their derivatives by one of them."""
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


def _fitted(solved: Solved, powers: IntArray) -> Array:
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


def _left_out(solved: Solved, powers: IntArray) -> Array:
    """Root mean square (4,) of what members left out of the fit are missed by."""
    numbers = np.unique(solved.member)
    missed = np.empty_like(solved.y)
    for fold in range(_FOLDS):
        out = np.isin(solved.member, numbers[fold::_FOLDS])
        kept = Solved(*(each[~out] for each in (solved.member, solved.x, solved.y, solved.slopes)))
        missed[out] = solved.y[out] - _terms(_scaled(solved.x[out]), powers) @ _fitted(kept, powers)
    return np.asarray(np.sqrt(np.mean(missed**2, axis=0)))


def _correction(fine: Solved, powers: IntArray, coefficients: Array) -> Array:
    """What a finer mesh adds (n_terms, 4): a plane through what the family misses of its members."""
    low = powers.sum(axis=1) <= _CORRECTION_DEGREE
    missed = fine.y - _terms(_scaled(fine.x), powers) @ coefficients
    a = _terms(_scaled(fine.x), powers[low])
    ridge = 0.05 * len(fine.x) * np.diag((powers[low].sum(axis=1) > 0).astype(float))
    added = np.zeros_like(coefficients)
    added[low] = np.linalg.solve(a.T @ a + ridge, a.T @ missed)
    return added
