"""All readings of a limb's sites as linear functionals of its fields of c, m and f_kappa."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from limbcli.model import Array
from limbcli.stiffness_field.coordinates import AnatomicalPlaces, LimbCoordinates
from limbcli.stiffness_field.forces import ForceReading, linear_reading
from limbcli.stiffness_field.likelihood import Bound, Known, likelihood_of
from limbcli.stiffness_field.readings import PARAMETERS, MapReading, SiteReading

_UNKNOWN_GAIN = 3.0  # standard deviation of ln c of a map's common error where nothing is known of it


@dataclass(frozen=True, eq=False)
class FieldReadings:
    """All readings as linear functionals of the fields.

    places : (q,) all points of all regions; average : (n, q) weights, rows sum to 1
    parameter : (n,) index into `PARAMETERS`; values : (n,) ln, NaN where `likelihoods` has one
    noise : (n, n) covariance of the errors of the normal readings; own : (n, n) 1 where two have the same
        site's own error
    correlated : (i, j, rho) of two readings of a site
    forces : first row of each force; it has one for every parameter, in their order
    model_error : (n, n) covariance of errors that count in the field's intervals but not in its mean: those
        of the models of the forces
    """

    places: AnatomicalPlaces
    average: Array
    parameter: NDArray[np.int_]
    values: Array
    noise: Array
    own: Array
    likelihoods: Mapping[int, Known | Bound]
    correlated: Sequence[tuple[int, int, float]]
    forces: Mapping[int, ForceReading]
    model_error: Array

    def __len__(self) -> int:
        return len(self.values)

    def part(self, which: NDArray[np.int_]) -> FieldReadings:
        """The readings of these numbers, ascending, without their correlations with others."""
        number = {k: n for n, k in enumerate(which.tolist())}
        return replace(
            self, average=self.average[which], parameter=self.parameter[which], values=self.values[which],
            noise=self.noise[np.ix_(which, which)], own=self.own[np.ix_(which, which)],
            model_error=self.model_error[np.ix_(which, which)],
            likelihoods={number[k]: each for k, each in self.likelihoods.items() if k in number},
            correlated=[
                (number[i], number[j], rho) for i, j, rho in self.correlated if i in number and j in number
            ],
        )  # fmt: skip


def gathered(
    limb: LimbCoordinates, sites: Sequence[SiteReading], maps: Sequence[MapReading], *, forces: bool
) -> FieldReadings:
    """The readings. forces : those of sites with a force are c and the force, whose rows are still empty;
    otherwise each parameter alone."""
    regions: list[tuple[int, int]] = []  # first point and number of points of each reading
    parameter: list[int] = []
    values: list[float] = []
    variances: list[float] = []
    owner: list[str] = []
    likelihoods: dict[int, Known | Bound] = {}
    correlated: list[tuple[int, int, float]] = []
    points: list[Array] = []
    of_force: dict[int, ForceReading] = {}
    n_points = 0
    for site in sites:
        index: dict[str, int] = {}
        together = site.force if forces else None
        for name, interval in site.values.items():
            if together is not None and name not in site.beside:
                continue
            found = likelihood_of(interval, where=f"{name} of site {site.name}")
            if found is None:
                continue
            k = index[name] = len(values)
            normal = isinstance(found, Known) and found.is_normal
            values.append(found.mode if isinstance(found, Known) and normal else np.nan)
            variances.append(found.variance if isinstance(found, Known) and normal else np.nan)
            if not normal:
                likelihoods[k] = found
            regions.append((n_points, len(site.points)))
            parameter.append(PARAMETERS.index(name))
            owner.append(site.name)
        for (one, other), rho in site.correlation.items():
            if one in index and other in index and not _is_bound(likelihoods, index[one], index[other]):
                correlated.append((index[one], index[other], rho))
        if together is not None:
            of_force[len(values)] = together
            for k in range(len(PARAMETERS)):
                values.append(0.0)
                variances.append(0.0)
                regions.append((n_points, len(site.points)))
                parameter.append(k)
                owner.append("")
        points.append(site.points)
        n_points += len(site.points)
    n_of_sites = len(values)
    for each in maps:
        for k, value in enumerate(each.log_c):
            regions.append((n_points + k, 1))
            values.append(float(value))
            variances.append(0.0)
            parameter.append(0)
            owner.append(each.site)
        points.append(each.points)
        n_points += len(each.points)
    n = len(values)
    average = np.zeros((n, n_points))
    for k, (first, count) in enumerate(regions):
        average[k, first : first + count] = 1.0 / count
    noise = np.diag(np.array(variances)) if n else np.zeros((0, 0))
    first = n_of_sites
    for each in maps:
        block = slice(first, first + len(each.log_c))
        gain = _UNKNOWN_GAIN if each.gain_deviation is None else each.gain_deviation
        noise[block, block] = each.covariance + gain**2
        first += len(each.log_c)
    kind = np.array(parameter, dtype=int)
    names = np.array(owner, dtype=str)
    own = (names[:, None] == names) & (kind[:, None] == kind) & (names != "")
    all_points = np.concatenate(points) if points else np.empty((0, 3))
    return FieldReadings(
        limb.places(all_points), average, kind, np.array(values, float), noise, own.astype(float),
        likelihoods, correlated, of_force, np.zeros((n, n)),
    )  # fmt: skip


def linear_about(readings: FieldReadings, logs: Array, own_error: float) -> FieldReadings:
    """The readings with the rows of all forces linear about the tissue of these logarithms (n,).

    own_error : of `linear_reading`
    """
    values, noise, errors = readings.values.copy(), readings.noise.copy(), readings.model_error.copy()
    for first, force in readings.forces.items():
        rows = slice(first, first + len(PARAMETERS))
        found = linear_reading(force, logs[rows], own_error)
        values[rows], noise[rows, rows], errors[rows, rows] = found.values, found.noise, found.model_error
    return replace(readings, values=values, noise=noise, model_error=errors)


def _is_bound(likelihoods: Mapping[int, Known | Bound], *which: int) -> bool:
    return any(isinstance(likelihoods.get(k), Bound) for k in which)
