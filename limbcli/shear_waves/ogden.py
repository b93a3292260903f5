"""Shear-wave speed in deformed tissue: small waves on a large deformation.

For an Ogden-type energy W = sum_k c_k/m_k^2 (sum_i l_i^{m_k} - 3 - m_k ln J) + kappa/2 (J-1)^2
the acoustic tensor of a plane wave along the unit vector n in the deformed tissue,
times J, is in the principal axes of b = F F'

    Q_pp = (l_p f'_p - 2 f_p) n_p^2 + sum_{q != p} G_pq n_q^2 + sum_q f_q n_q^2
    Q_pq = G_pq n_p n_q,   G_pq = (f_p l_q^2 - f_q l_p^2) / (l_p^2 - l_q^2)

with f(l) = l dW/dl = sum_k c_k/m_k (l^{m_k} - 1), to which the volumetric part adds
kappa J^2 n_p n_q. The latter acts along n only: a shear wave (polarised across n)
does not feel kappa. Then rho0 v^2 = a.Q a for the polarisation a.

Source: Ogden, Non-Linear Elastic Deformations (1984), ch. 6, small waves on a large
static deformation; Destrade & Ogden 2010, J Acoust Soc Am 128:3334.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from limbcli import units
from limbcli.errors import MeasurementError
from limbcli.model import Array, Material

MAX_TERMS = 6
_COINCIDENT = 1e-5


@dataclass(frozen=True, eq=False)
class OgdenTerms:
    """Stiffness of an Ogden-type law: c (n_terms,) or (n_points, n_terms) MPa; m (n_terms,); kappa MPa."""

    c: Array
    m: Array
    kappa: float = 0.0

    @staticmethod
    def one_pair(*, c: float, m: float, kappa: float = 0.0, weight: float = 0.5) -> OgdenTerms:
        """The pair (weight c, m), ((1 - weight) c, -m): weight 1/2 is the law limbcli identifies."""
        return OgdenTerms(np.array([weight * c, (1 - weight) * c]), np.array([m, -m]), kappa)

    @staticmethod
    def of(material: Material) -> OgdenTerms:
        """The terms of a `Material` with law "ogden" and plain numbers for parameters.

        Raises
        ------
        MeasurementError
            If the law is another one, or a parameter is a map or a curve.
        """
        p: Mapping[str, object] = material.parameters
        c, m = [], []
        for k in range(1, MAX_TERMS + 1):
            if f"c{k}" in p:
                c.append(p[f"c{k}"])
                m.append(p[f"m{k}"])
        if material.law != "ogden" or not all(isinstance(each, int | float) for each in [*c, *m]) or not c:
            raise MeasurementError(
                f"the wave speed cannot be predicted for the law {material.law!r} with these parameters",
                where="shear-wave prediction",
                fix="it needs an Ogden-type law with numbers for c1, m1, ...",
            )
        kappa = p.get("kappa", 0.0)
        return OgdenTerms(
            np.array(c, dtype=float),
            np.array(m, dtype=float),
            float(kappa) if isinstance(kappa, int | float) else 0.0,
        )


def acoustic_tensor(
    deformation_gradient: Array, direction: Array, terms: OgdenTerms, *, volumetric: bool = True
) -> Array:
    """J times the acoustic tensor, Q_ik = J (c_ijkl + sigma_jl delta_ik) n_j n_l.

    Parameters
    ----------
    deformation_gradient : (n_points, 3, 3), det > 0
    direction : (3,) or (n_points, 3), unit, in the deformed tissue
    volumetric : with the part of kappa; leave it out for shear waves alone

    Returns
    -------
    (n_points, 3, 3) MPa; its eigenvalues are rho0 v^2.

    Raises
    ------
    MeasurementError
        If a deformation gradient is not finite or turns an element inside out.
    """
    F = np.asarray(deformation_gradient, dtype=float)
    _check_invertible(F)
    n = np.broadcast_to(np.asarray(direction, dtype=float), (len(F), 3))
    square, axes = np.linalg.eigh(F @ np.swapaxes(F, 1, 2))
    stretch = np.sqrt(square)
    f, slope = _principal(stretch, terms)
    along = np.einsum("nip,ni->np", axes, n)
    G = _shear_terms(stretch, f, slope)
    Q = G * along[:, :, None] * along[:, None, :]
    diagonal = (slope - 2 * f) * along**2 + np.einsum("npq,nq->np", G, along**2)
    diagonal += np.einsum("nq,nq->n", f, along**2)[:, None]
    i = np.arange(3)
    Q[:, i, i] = diagonal
    if volumetric:
        J2 = np.prod(square, axis=1)
        Q += terms.kappa * J2[:, None, None] * along[:, :, None] * along[:, None, :]
    return np.asarray(np.einsum("nip,npq,njq->nij", axes, Q, axes))


def _check_invertible(F: Array) -> None:
    determinant = np.linalg.det(F)
    wrong = np.flatnonzero(~(determinant > 0))
    if len(wrong):
        raise MeasurementError(
            f"{len(wrong)} deformation gradients are not those of a material (the first has det F = "
            f"{determinant[wrong[0]]:.3g})",
            where=f"shear-wave prediction, point {wrong[0]}",
            fix="the simulation holds inverted elements; run it with smaller steps or a better mesh",
            count=len(wrong),
        )


def _principal(stretch: Array, terms: OgdenTerms) -> tuple[Array, Array]:
    """f(l) and l f'(l), (n_points, 3)."""
    c = np.broadcast_to(terms.c, (len(stretch), len(terms.m)))
    powers = stretch[:, :, None] ** terms.m
    f = np.einsum("nk,npk->np", c / terms.m, powers - 1)
    return f, np.einsum("nk,npk->np", c, powers)


def _shear_terms(stretch: Array, f: Array, slope: Array) -> Array:
    """G_pq (n_points, 3, 3), zero on the diagonal; its limit where two stretches meet."""
    square = stretch**2
    difference = square[:, :, None] - square[:, None, :]
    meet = np.abs(difference) < _COINCIDENT * square[:, :, None]
    numerator = f[:, :, None] * square[:, None, :] - f[:, None, :] * square[:, :, None]
    limit = slope / 2 - f
    limit = (limit[:, :, None] + limit[:, None, :]) / 2
    G = np.where(meet, limit, numerator / np.where(meet, 1.0, difference))
    i = np.arange(3)
    G[:, i, i] = 0.0
    return G


def wave_speed_m_per_s(
    deformation_gradient: Array,
    terms: OgdenTerms,
    *,
    direction: tuple[float, float, float] = (1.0, 0.0, 0.0),
    polarisation: tuple[float, float, float] = (0.0, 0.0, 1.0),
    density_kg_per_m3: float = 1000.0,
    mode: Literal["polarised", "eigenmode"] = "eigenmode",
) -> Array:
    """Speed of the shear wave that runs along `direction` and moves the tissue along `polarisation`.

    In the probe's frame that is along x, moving along z (the beam). "polarised" is
    rho0 v^2 = a.Q a; "eigenmode" takes, of the two shear waves across the direction, the
    one that moves most along the polarisation. They agree in a plane of symmetry. Neither
    feels kappa (the tissue is nearly incompressible: corrections are of order mu / kappa).

    Returns
    -------
    (n_points,) m/s; NaN where no wave can run (rho0 v^2 <= 0, the tissue buckles).

    >>> terms = OgdenTerms.one_pair(c=0.008, m=6.0)
    >>> wave_speed_m_per_s(np.eye(3)[None], terms)
    array([2.])
    """
    n = np.array(direction) / np.linalg.norm(direction)
    Q = acoustic_tensor(deformation_gradient, n, terms, volumetric=False)
    return shear_speed_m_per_s(
        Q, direction=direction, polarisation=polarisation, density_kg_per_m3=density_kg_per_m3, mode=mode
    )


def shear_speed_m_per_s(
    Q: Array,
    *,
    direction: tuple[float, float, float] = (1.0, 0.0, 0.0),
    polarisation: tuple[float, float, float] = (0.0, 0.0, 1.0),
    density_kg_per_m3: float = 1000.0,
    mode: Literal["polarised", "eigenmode"] = "eigenmode",
) -> Array:
    """As `wave_speed_m_per_s`, of acoustic tensors J Q (n_points, 3, 3) MPa for `direction`."""
    n = np.array(direction) / np.linalg.norm(direction)
    a = np.array(polarisation, dtype=float)
    a -= (a @ n) * n
    a /= np.linalg.norm(a)
    if mode == "polarised":
        modulus = np.einsum("i,nij,j->n", a, Q, a)
    else:
        basis = np.stack([a, np.cross(n, a)])
        values, vectors = np.linalg.eigh(np.einsum("ai,nij,bj->nab", basis, Q, basis))
        nearest = np.argmax(np.abs(vectors[:, 0, :]), axis=1)
        modulus = np.take_along_axis(values, nearest[:, None], axis=1)[:, 0]
    density = units.tonne_per_mm3_from_kg_per_m3(density_kg_per_m3)
    speed = np.sqrt(np.where(modulus > 0, modulus, np.nan) / density)
    return units.m_per_s_from_mm_per_s(speed)
