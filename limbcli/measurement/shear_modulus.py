"""Shear modulus of the tissue from the speed of shear waves, and their speed from what a scanner shows."""

from __future__ import annotations

import numpy as np

from limbcli.errors import MeasurementError
from limbcli.model import Array
from limbcli.numbers import units


def shear_modulus_from_wave_speed(wave_speed_m_per_s: Array, *, density_kg_per_m3: float = 1000.0) -> Array:
    """Small-strain shear modulus from the shear-wave speed.

    mu = rho * v**2: linear, isotropic, unbounded, lossless tissue. In a thin or pre-stretched layer this is
    biased.

    wave_speed_m_per_s : array, shape (n_samples,), m/s, > 0
    density_kg_per_m3 : float, kg/m^3

    Returns (n_samples,) MPa

    Raises MeasurementError if a speed is not finite and positive (index and value given).

    Source: Sarvazyan et al. 1998, Ultrasound Med Biol 24:1419.

    >>> shear_modulus_from_wave_speed(np.array([2.0]))
    array([0.004])
    """
    speed = np.asarray(wave_speed_m_per_s, dtype=float)
    wrong = np.flatnonzero(~(np.isfinite(speed) & (speed > 0)).ravel())
    if len(wrong):
        value = float(speed.ravel()[wrong[0]])
        raise MeasurementError(
            f"the shear-wave speed of sample {wrong[0]} is {value:g} m/s, not a positive number",
            where="shear-wave speeds",
            fix="omit the sample, or correct it (m/s)",
            index=int(wrong[0]),
            value_m_per_s=value,
        )
    return units.mpa_from_pa(density_kg_per_m3 * speed**2)


def speed_from_young(mean_kpa: Array, sd_kpa: Array) -> tuple[Array, Array]:
    """Mean and standard deviation of the speeds, m/s, from those of E = 3 rho v**2 with rho 1000 kg/m^3.

    Scanners show E, in kPa, of a region of interest (a "Q-Box"). Both figures are right to the second order
    of SD / mean; for the mean speed that is a correction of SD^2 / (8 mean^2). Moduli that are not positive
    give speeds that are not. All shapes (n_levels,).

    >>> mean, sd = speed_from_young(np.array([12.0]), np.array([3.0]))
    >>> mean.round(3), sd.round(3)
    (array([1.984]), array([0.25]))
    """
    of_mean = np.sign(mean_kpa) * np.sqrt(np.abs(mean_kpa) / 3.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        spread = np.where(np.isfinite(sd_kpa), sd_kpa / mean_kpa, 0.0)
    return of_mean * (1.0 - spread**2 / 8.0), np.where(np.isfinite(sd_kpa), of_mean * spread / 2.0, np.nan)
