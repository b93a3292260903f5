"""What probability of "nothing" occurs by chance where nothing is missing."""

from __future__ import annotations

import numpy as np

from limbcli.diagnostics import decisions
from limbcli.diagnostics.evidence.linear_evidence import LinearEvidence
from limbcli.diagnostics.model.noise import unit_errors


def least_by_chance(linear: LinearEvidence, ln_odds: float, rng: np.random.Generator) -> float:
    """Probability of "nothing" against all single effects, below which a share `FALSE_ALARMS` of draws lies.

    The draws are of the noise about the fit without effects, in the linear model that each effect is to first
    order: no simulation is needed. 0 if there are no effects.

    ln_odds : prior odds of a single effect over nothing
    """
    if not linear.added:
        return 0.0
    drawn = unit_errors(rng, (decisions.N_DRAWS, len(linear.residual)))
    table = np.array([linear.ln_factor(name, drawn) for name in linear.added]) + ln_odds
    ln_something = np.logaddexp.reduce(table, axis=0)
    return float(np.quantile(1.0 / (1.0 + np.exp(ln_something)), decisions.FALSE_ALARMS))
