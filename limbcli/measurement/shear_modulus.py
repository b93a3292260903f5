"""Shear modulus of the tissue from the speed of shear waves."""

from __future__ import annotations

import numpy as np

from limbcli.errors import MeasurementError
from limbcli.model import Array
from limbcli.numbers import units


def shear_modulus_from_wave_speed(wave_speed_m_per_s: Array, *, density_kg_per_m3: float = 1000.0) -> Array:
    """Small-strain shear modulus from the shear-wave speed.

    mu = rho * v**2: linear, isotropic, unbounded, lossless tissue. In a thin or pre-stretched layer this is
    biased.

    Parameters
    ----------
    wave_speed_m_per_s : array, shape (n_samples,), m/s, > 0
    density_kg_per_m3 : float, kg/m^3

    Returns
    -------
    array, shape (n_samples,), MPa

    Raises
    ------
    MeasurementError
        If a speed is not finite and positive (index and value given).

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
