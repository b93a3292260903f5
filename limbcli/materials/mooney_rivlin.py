"""Uncoupled Mooney-Rivlin law: W = c1 (I1 - 3) + c2 (I2 - 3) + k/2 (ln J)^2, with I1, I2 of J^(-1/3) l.

It consists of two Ogden terms with exponents 2 and -2 and moduli 4 c.
Source: FEBio User Manual 4.0, "Mooney-Rivlin".
"""

from __future__ import annotations

from limbcli.materials.law import FebioNames, Law
from limbcli.materials.ogden_uncoupled import KERNEL

LAW = Law(
    "mooney_rivlin",
    KERNEL,
    {"c1": None, "c2": 0.0, "kappa": None},
    lambda v: [v["kappa"], 4.0 * v["c1"], 2.0, 4.0 * v["c2"], -2.0],
    {2: None, 4: None},
    extra=lambda v: 2,
    positive=("kappa",),
    uncoupled=True,
    febio=FebioNames("Mooney-Rivlin", (("c1", "c1"), ("c2", "c2"), ("k", "kappa"))),
)
