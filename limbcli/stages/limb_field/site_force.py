"""The force of a fitted or diagnosed site as a reading of the stiffness field.

The field's tissue is to give the force that the fit found, in the whole limb. A site's model is held at its
cuts, a limb gives way beyond them. Where its force was not simulated (`limb_force`), it is taken to lie
half-way (in logarithms) to that with free cuts. A diagnosis is half-way already; its force is that of the
tissue without the effects that it named, as the limb has none of them.

The force at the deepest level is met, the others are within their noise. The noise of the deepest level
counts as an error that does not move the field but widens its intervals.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from limbcli.effects.crop import LIMB_POSITION
from limbcli.feb.settings import USUAL_PENALTY
from limbcli.inference.surrogate import Node, Surrogate
from limbcli.model import Array
from limbcli.numbers.units import mpa_from_kpa
from limbcli.stiffness_field.forces import ForceReading

_MET = 0.01  # how closely the field's tissue gives the force at the deepest level
KEYS = ("c_kpa", "tissue_force", "boundary_check/cut_free")  # of fit.json


def force_reading(data: Mapping[str, Any], *, c_kpa: float) -> ForceReading | None:
    """The reading from the data of fit.json or diagnosis.json; None where there is none: a fit without noise
    to weigh its forces by, a diagnosis whose f_kappa was not varied.

    c_kpa : of the fitted tissue
    """
    told = data.get("tissue_force")
    if not told:
        return None
    depths = np.array(told["depths_mm"], float)
    solved, log_c = told["simulated"], float(np.log(mpa_from_kpa(c_kpa)))
    share = np.array(told["c_share"], float)
    places = np.log([solved["m"], solved["f_kappa"]]).T
    slopes = np.array(solved["slopes_of_ln"], float)[..., ::-1]  # written by f_kappa, m
    forces = np.log(np.array(solved["forces_n"], float))
    surrogate = Surrogate([Node(*each) for each in zip(places, forces, slopes, strict=True)])

    def predict(logs: Array) -> tuple[Array, Array]:
        value, slope = surrogate(logs[1:])
        return value + share * (logs[0] - log_c), np.column_stack([share, slope])

    fitted, noise = np.array(told["fitted_n"], float), np.array(told["noise_n"], float)
    errors = np.array(told["model_errors_of_ln"], float).reshape(-1, len(depths))
    deepest = int(np.argmax(depths))
    unsure = np.where(np.arange(len(depths)) == deepest, noise / fitted, 0.0)
    noise[deepest] = min(noise[deepest], _MET * fitted[deepest])
    return ForceReading(
        depths=depths, fitted=fitted, noise=noise, limb_over_site=half_way_to_free(data, depths),
        model_errors=np.vstack([errors, unsure]), predict=predict,
        contact_penalty=float(told.get("contact_penalty", USUAL_PENALTY)),
    )  # fmt: skip


def half_way_to_free(data: Mapping[str, Any], depths: Array) -> Array:
    """Force of the whole limb over that of the site's model at depths (n,) mm, of the same tissue, as taken
    where it was not simulated; 1 where free cuts were not either."""
    freed = (data.get("boundary_check") or {}).get("cut_free", {})
    if not freed.get("depths_mm"):
        return np.ones(len(depths))
    changes = np.log1p(np.array(freed["force_change_fraction"], float))
    return np.exp(LIMB_POSITION * np.interp(depths, freed["depths_mm"], changes))
