"""A cheap limb: force on a probe over a bonded layer, with f_kappa and m in their usual roles.

Force = c a H g(f_kappa) sinh(0.8 m e) / (0.8 m), e = -ln(1 - d/H). With "tet10" the
compressibility matters little above f_kappa 50; with "tet4" it stiffens without end (locking).
"""

import numpy as np

from limbcli.inference.prediction import Prediction

THICKNESS, FOOT = 25.0, 100.0


def force(depth, c, f_kappa, m, kind="tet10"):
    strain = -np.log(1.0 - depth / THICKNESS)
    bulk = 1 - 0.25 / (1 + f_kappa / 4) if kind == "tet10" else (1 + f_kappa / 8) ** 0.4
    return c * FOOT * THICKNESS * bulk * np.sinh(0.8 * m * strain) / (0.8 * m)


def curve(knots, c, kind="tet10"):
    """(f_kappa, m) -> forces at the knots, with derivatives."""

    def answer(theta, wrt=()):
        step = 1e-6
        columns = []
        for k in range(2):
            up, down = np.array(theta, float), np.array(theta, float)
            up[k] *= 1 + step
            down[k] *= 1 - step
            rise = force(knots, c, *up, kind) - force(knots, c, *down, kind)
            columns.append(rise / (up[k] - down[k]))
        return Prediction(force(knots, c, *theta, kind), np.column_stack(columns))

    return answer
