"""Small-amplitude plane waves in deformed tissue of the Ogden family, in closed form.

For an Ogden-type energy W = sum_k c_k/m_k^2 (sum_i l_i^{m_k} - 3 - m_k ln J) + kappa/2 (J-1)^2
the acoustic tensor of a plane wave along the unit vector n in the deformed tissue, times J, is in the
principal axes of b = F F'

    Q_pp = (l_p f'_p - 2 f_p) n_p^2 + sum_{q != p} G_pq n_q^2 + sum_q f_q n_q^2
    Q_pq = G_pq n_p n_q,   G_pq = (f_p l_q^2 - f_q l_p^2) / (l_p^2 - l_q^2)

with f(l) = l dW/dl = sum_k c_k/m_k (l^{m_k} - 1), to which the volumetric part adds kappa J^2 n_p n_q. The
latter acts along n only: a shear wave (polarised perpendicular to n) is independent of kappa. Then rho0 v^2 =
a.Q a for the polarisation a.

Source: Ogden, Non-Linear Elastic Deformations (1984), ch. 6, small waves on a large static deformation;
Destrade & Ogden 2010, J Acoust Soc Am 128:3334.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from limbcli.errors import MeasurementError
from limbcli.model import Array, ElementMap, IntArray, Material

MAX_TERMS = 6
_COINCIDENT = 1e-5


@dataclass(frozen=True, eq=False)
class OgdenTerms:
    """Parameters of an Ogden-type law: c (n_terms,) or (n_points, n_terms) MPa; m (n_terms,); kappa MPa."""

    c: Array
    m: Array
    kappa: float = 0.0

    @staticmethod
    def one_pair(*, c: float, m: float, kappa: float = 0.0, weight: float = 0.5) -> OgdenTerms:
        """The pair (weight c, m), ((1 - weight) c, -m); weight 1/2 gives the law that limbcli identifies."""
        return OgdenTerms(np.array([weight * c, (1 - weight) * c]), np.array([m, -m]), kappa)

    @staticmethod
    def of(material: Material) -> OgdenTerms:
        """The terms of a `Material` with law "ogden" and plain numbers as parameters.

        Raises MeasurementError if it is another law, or a parameter is a map or a curve.
        """
        terms = terms_of(material) if material.law == "ogden" else None
        if terms is None:
            raise MeasurementError(
                f"the wave speed cannot be predicted for the law {material.law!r} with these parameters",
                where="shear-wave prediction",
                fix="it needs an Ogden-type law with numbers for c1, m1, ...",
            )
        kappa = material.parameters.get("kappa", 0.0)
        return OgdenTerms(terms.c[0], terms.m, float(kappa) if isinstance(kappa, int | float) else 0.0)


def terms_of(material: Material, cells: IntArray | None = None) -> OgdenTerms | None:
    """The shear terms of a law of the Ogden family; neo-Hooke is Ogden's law with m = 2.

    cells : (n,) of the material's block; if the stiffness is a map, c is (n, n_terms), else (1, n_terms)

    None for other laws, and if a parameter is a curve. kappa is omitted.
    """
    if material.law == "neo_hooke" and isinstance(material.parameters["mu"], int | float):
        return OgdenTerms(np.array([2 * float(material.parameters["mu"])]), np.array([2.0]))
    if material.law != "ogden":
        return None
    p = material.parameters
    c, m = [], []
    for k in range(1, MAX_TERMS + 1):
        value, exponent = p.get(f"c{k}"), p.get(f"m{k}")
        if value is None:
            continue
        mapped = isinstance(value, ElementMap) and cells is not None
        stiffness = value.values[cells] if mapped else value  # type: ignore[union-attr]
        if not isinstance(stiffness, int | float | np.ndarray) or not isinstance(exponent, int | float):
            return None
        c.append(stiffness)
        m.append(float(exponent))
    if not c:
        return None
    if cells is None:
        return OgdenTerms(np.array([c], dtype=float), np.array(m))
    return OgdenTerms(np.stack([np.broadcast_to(each, cells.shape) for each in c], axis=-1), np.array(m))


def principal_modulus(terms: OgdenTerms, along: Array, moving: Array) -> Array:
    """rho0 v^2 (n,) MPa of the wave along one principal axis that is polarised along another.

    rho0 v^2 = l^2 (f(l) - f(q)) / (l^2 - q^2), f(l) = sum c_k / m_k l^(m_k), with the stretches l along the
    wave and q along the polarisation; `acoustic_tensor` gives the same for a wave along a principal axis.
    along, moving (n,) > 0; c, and here also m, are (n_terms,) or (n, n_terms).

    Source: Ogden 1984, Non-Linear Elastic Deformations, eq. 6.4.21 ff.

    >>> principal_modulus(OgdenTerms.one_pair(c=0.008, m=2.0), np.array([1.0, 1.2]), np.array([1.0, 1.0]))
    array([0.004  , 0.00488])
    """
    c, m = terms.c, terms.m
    # powers are written as hyperbolic functions to avoid 0 / 0
    middle = 0.5 * np.log(np.asarray(along) * moving)[:, None]
    half = 0.5 * np.log(np.asarray(along) / moving)[:, None]
    rise = np.sum(c * np.exp(m * middle) * _sinh_ratio(m * half), axis=1)
    return np.asarray(along**2 * rise / (2.0 * np.exp(2.0 * middle) * _sinh_ratio(2.0 * half))[:, 0])


def _sinh_ratio(x: Array) -> Array:
    """sinh(x) / x."""
    small = np.abs(x) < 1e-4
    safe = np.where(small, 1.0, x)
    return np.where(small, 1.0 + x * x / 6.0, np.sinh(safe) / safe)


def acoustic_tensor(
    deformation_gradient: Array, direction: Array, terms: OgdenTerms, *, volumetric: bool = True
) -> Array:
    """J times the acoustic tensor, Q_ik = J (c_ijkl + sigma_jl delta_ik) n_j n_l.

    deformation_gradient : (n_points, 3, 3), det > 0
    direction : (3,) or (n_points, 3), unit, in the deformed tissue
    volumetric : include the contribution of kappa; not needed for shear waves

    Returns (n_points, 3, 3) MPa; its eigenvalues are rho0 v^2.

    Raises MeasurementError if a deformation gradient is not finite or has a non-positive determinant.
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
            f"{len(wrong)} deformation gradients are not physical (the first has det F = "
            f"{determinant[wrong[0]]:.3g})",
            where=f"shear-wave prediction, point {wrong[0]}",
            fix="the simulation contains inverted elements; run it with smaller steps or a better mesh",
            count=len(wrong),
        )


def _principal(stretch: Array, terms: OgdenTerms) -> tuple[Array, Array]:
    """f(l) and l f'(l), (n_points, 3)."""
    c = np.broadcast_to(terms.c, (len(stretch), len(terms.m)))
    powers = stretch[:, :, None] ** terms.m
    f = np.einsum("nk,npk->np", c / terms.m, powers - 1)
    return f, np.einsum("nk,npk->np", c, powers)


def _shear_terms(stretch: Array, f: Array, slope: Array) -> Array:
    """G_pq (n_points, 3, 3), zero on the diagonal; the limit is used where two stretches coincide."""
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
