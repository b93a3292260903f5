"""What a fit's forces say of c, f_kappa and m together: its simulations, and the noise that it counted.

A force often identifies neither f_kappa nor m alone, but well which of them belong together. The stiffness
field of the limb takes this from here (`limb`).
"""

from __future__ import annotations

import numpy as np

from limbcli.fitting.table import Identified, c_share, counted_deviation
from limbcli.inference.geometry_uncertainty import at_depths
from limbcli.inference.monotone_interpolation import pchip_sample
from limbcli.inference.two_step_fit import sensitivities
from limbcli.results import StageWriter


def write_tissue_force(found: Identified, contact_penalty: float, writer: StageWriter) -> None:
    """Write `tissue_force`: the fitted forces at the loaded levels, their noise, and all simulations.

    contact_penalty : of these simulations

    Nothing is written where the case states no noise, or the simulations lack derivatives.
    """
    step = found.steps[-1]
    noise = counted_deviation(found, step)
    solved = [each for each in found.curve.solved if each[1].has((0, 1))]
    if not noise.any() or not solved:
        return
    depths = found.data.depth[found.data.loaded]
    errors = [np.full(len(depths), found.gain_of(step))]
    if found.modes is not None:
        errors += list(at_depths(found.modes, found.knots, depths).T)
    knots, forces, slopes = np.r_[0.0, found.knots], [], []
    for theta, answer in solved:
        assert answer.jacobian is not None
        sample = pchip_sample(knots, np.r_[0.0, answer.values], depths)
        forces.append(sample.values)
        slopes.append(sample.weights[:, 1:] @ (answer.jacobian * theta) / sample.values[:, None])
    scale = found.intervals[-1].scale if found.intervals else 1.0
    writer.data["tissue_force"] = {
        "depths_mm": depths,
        "fitted_n": sensitivities(found, step.theta).values,
        "noise_n": np.sqrt(scale) * noise,
        "model_errors_of_ln": np.array(errors),
        "c_share": c_share(found),
        "contact_penalty": contact_penalty,
        "simulated": {
            "f_kappa": [float(theta[0]) for theta, _ in solved],
            "m": [float(theta[1]) for theta, _ in solved],
            "forces_n": np.array(forces),
            "slopes_of_ln": np.array(slopes),
        },
    }
