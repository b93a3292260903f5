"""What a diagnosis says of the tissue's own force: that of c, m and f_kappa without the effects it named.

The stiffness field of the limb takes it as it takes the `tissue_force` of a fit.
"""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np

from limbcli.diagnosis.data.noise_parts import COMPRESSIBILITY
from limbcli.diagnosis.explanations.conclusions import Diagnosis
from limbcli.diagnosis.forward_model.predictions import NOTHING
from limbcli.diagnosis.forward_model.surrogate import SiteCurves
from limbcli.diagnosis.mesh_error.numerical_checks import STIFFER, f_kappa_at
from limbcli.effects.curves import log_force_at
from limbcli.feb.settings import USUAL_PENALTY
from limbcli.model import Array
from limbcli.numbers.units import mpa_from_kpa

_STEP = 0.02  # of ln m, in the derivatives
_MOST_APART = 2.0  # factor between the m found and those of the other forces
_STIFFEST = 1.0  # deviations of f_kappa from the value in the models: the largest that is simulated
# Penalty of a probe that presses as hard as in the diagnosis' curves, which have no penetration: the demo's
# limb (edges of 2.5 mm) gives 0.9 % more force with it than with the usual one, and 0.4 % less than without
# penetration.
_HARD = 4.0 * USUAL_PENALTY


def diagnosed_force(found: Diagnosis, curves: SiteCurves) -> dict[str, Any] | None:
    """`tissue_force` of diagnosis.json, at the loaded levels: the forces of the tissue that was found, their
    noise, the errors of the model, and forces of other m and f_kappa with their derivatives.

    None where the influence of f_kappa was not computed, or no level is loaded.
    """
    site, estimates = curves.site, found.shrink[-1].estimates
    common = {each.name: each for each in found.common_errors.get(found.chosen, ())}
    errors = {each.name: each for each in site.model.errors if each.name in common}
    read, noise = site.seen.protocol, site.seen.noise
    loaded = np.flatnonzero((read.force > 0) & (read.depth > 0) & site.seen.levels.loading[site.seen.keep])
    if COMPRESSIBILITY not in errors or not len(loaded):
        return None
    depths, levels = read.depth[loaded], site.seen.keep[loaded]
    by_f_kappa = errors[COMPRESSIBILITY].log_force[levels]
    c, m, f_kappa = mpa_from_kpa(estimates.values["c_kpa"]), estimates.values["m"], common[COMPRESSIBILITY]

    def logs(ln_m: float, deviations: float = 0.0) -> Array:
        curve = curves.curves(c, float(np.exp(ln_m)), NOTHING, {})
        return log_force_at(curve, depths) + deviations * by_f_kappa

    at = min(f_kappa.value, _STIFFEST)
    around = np.unique([0.0, at, at - f_kappa.deviation])
    other_m = np.clip([*estimates.intervals["m"], m], m / _MOST_APART, m * _MOST_APART)
    places = list(itertools.product(np.unique(other_m).tolist(), around.tolist()))
    # a deviation of f_kappa is one of 1 / f_kappa (`f_kappa_at`)
    slopes = [
        np.column_stack([
            (1.0 / (1.0 - 1.0 / STIFFER) - z) * by_f_kappa,
            (logs(np.log(each) + _STEP) - logs(np.log(each) - _STEP)) / (2 * _STEP),
        ])
        for each, z in places
    ]  # fmt: skip
    rise = curves.curves(c, m, NOTHING, {}).force_curve.read(depths).slopes
    return {
        "depths_mm": depths,
        "fitted_n": np.exp(logs(np.log(m), at)),
        "noise_n": np.hypot(noise.force, rise * noise.depth),
        "model_errors_of_ln": [
            common[name].deviation * each.log_force[levels]
            for name, each in errors.items() if name != COMPRESSIBILITY and each.log_force.any()
        ],
        "c_share": np.ones(len(depths)),
        "contact_penalty": _HARD,
        "simulated": {
            "f_kappa": [f_kappa_at(z) for _, z in places],
            "m": [each for each, _ in places],
            "forces_n": [np.exp(logs(np.log(each), z)) for each, z in places],
            "slopes_of_ln": slopes,
        },
    }  # fmt: skip
