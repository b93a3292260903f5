"""The force of a fitted site as a reading of the stiffness field.

The field's tissue is to give the force that the fit found, in the whole limb. A site's model is held at its
cuts, a limb gives way beyond them: it needs a tissue with as much more force in the site's model as it gives
less, half-way (in logarithms) to what free cuts change.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from limbcli.effects.crop import LIMB_POSITION
from limbcli.inference.surrogate import Node, Surrogate
from limbcli.model import Array
from limbcli.numbers.units import mpa_from_kpa
from limbcli.stiffness_field.forces import ForceReading

KEYS = ("c_kpa", "tissue_force", "boundary_check/cut_free")  # of fit.json


def force_reading(data: Mapping[str, Any]) -> ForceReading | None:
    """The reading from the data of fit.json; None where the fit had no noise to weigh its forces by."""
    told = data.get("tissue_force")
    if not told:
        return None
    less = limb_over_site(data, np.array(told["depths_mm"], float))
    solved, log_c = told["simulated"], float(np.log(mpa_from_kpa(float(data["c_kpa"]))))
    share = np.array(told["c_share"], float)
    places = np.log([solved["m"], solved["f_kappa"]]).T
    slopes = np.array(solved["slopes_of_ln"], float)[..., ::-1]  # written by f_kappa, m
    forces = np.log(np.array(solved["forces_n"], float))
    surrogate = Surrogate([Node(*each) for each in zip(places, forces, slopes, strict=True)])

    def predict(logs: Array) -> tuple[Array, Array]:
        value, slope = surrogate(logs[1:])
        return value + share * (logs[0] - log_c), np.column_stack([share, slope])

    return ForceReading(
        np.array(told["fitted_n"], float) / less, np.array(told["noise_n"], float) / less,
        np.array(told["model_errors_of_ln"], float), predict,
    )  # fmt: skip


def limb_over_site(data: Mapping[str, Any], depths: Array) -> Array:
    """Force of the whole limb over that of the site's model at depths (n,) mm, with the same tissue; 1 where
    free cuts were not simulated."""
    freed = (data.get("boundary_check") or {}).get("cut_free", {})
    if not freed.get("depths_mm"):
        return np.ones(len(depths))
    changes = np.log1p(np.array(freed["force_change_fraction"], float))
    return np.exp(LIMB_POSITION * np.interp(depths, freed["depths_mm"], changes))
