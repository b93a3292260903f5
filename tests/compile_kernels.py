"""`python -m tests.compile_kernels`: kernels that small models need beside those of a limb.

Without it, two test processes would each compile them at their beginning.
"""

from __future__ import annotations

import numpy as np

from limbcli.feb.settings import schedule
from limbcli.fitting.force_curves import LawCurve
from limbcli.fitting.laws import LAWS
from limbcli.site_model.indentation_model import indentation_model
from tests.stages.block_case import block_model


def compile_them() -> None:
    """Simulate a block, whose equations are solved in double precision, with derivatives and wave speeds."""
    for element in ("tet4", "tet10"):
        block = block_model(element, counts=(4, 3, 2))
        model = indentation_model(block, schedule([0.5]), c=0.008, f_kappa=100.0, m=2.0)
        curve = LawCurve(model, LAWS["ogden"], c=0.008, density_kg_per_m3=1000.0)
        curve(np.array([each.start for each in LAWS["ogden"].shape]), (0, 1))
        curve.close()


if __name__ == "__main__":
    compile_them()
