"""Small models whose records are compared with FEBio's.

Every logged variable: one of every law, one turning body. The rows that are written: one of every way to ask.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from limbcli.fem.record_fields import BODY_FIELDS, CELL_FIELDS, NODE_FIELDS
from limbcli.materials import ogden_type
from limbcli.model import Block, Curve, Curved, LimbModel, LogRecord, Material, Mesh, Step, Support
from limbcli.model.bodies import Drive, RigidBody
from tests.fem.small_models import block

_ALONG = {"fiber": (0.6, 0.0, 0.8)}
_SOFT = ogden_type(c=0.005, f_kappa=5.0, m=4.0)
_FIBRES = Material("fiber_exp_pow", {"ksi": 0.003, "alpha": 5.0, "beta": 2.5, "mu": 0.001, **_ALONG})
_MUSCLE = Material("active_contraction", {"T0": 0.002, **_ALONG})
_ONE_TERM = {"g0": 1.0, "g1": 0.8, "t1": 0.7}
_STRETCH = (1.08, 0.0, 0.0, 0.0, 0.95, 0.0, 0.0, 0.0, 1.02)

LAWS = {
    "ogden": _SOFT,
    "ogden_uncoupled": Material(
        "ogden_uncoupled", {"c1": 0.003, "m1": 3.0, "c2": 0.002, "m2": -2.0, "kappa": 0.05}
    ),
    "mooney_rivlin": Material("mooney_rivlin", {"c1": 0.002, "c2": 0.001, "kappa": 0.05}),
    "neo_hooke": Material("neo_hooke", {"mu": 0.003, "lambda": 0.02}),
    "holmes_mow": Material("holmes_mow", {"mu": 0.003, "lambda": 0.004, "beta": 0.8}),
    "fiber_exp_pow": Material("mixture", {}, (_SOFT, _FIBRES)),
    "active_contraction": Material("mixture", {}, (_SOFT, _MUSCLE)),
    "prestrain": Material("prestrain", {"ramp": Curved(1.0, "ramp"), "F0": _STRETCH}, (_SOFT,)),
    "viscoelastic": Material("viscoelastic", _ONE_TERM, (_SOFT,)),
    "viscoelastic_weak": Material("viscoelastic", {**_ONE_TERM, "g0": 0.4}, (_SOFT,)),
    "viscoelastic_two": Material("viscoelastic", {**_ONE_TERM, "g2": 0.3, "t2": 6.0}, (_SOFT,)),
    "viscoelastic_fibres": Material("viscoelastic", _ONE_TERM, (Material("mixture", {}, (_SOFT, _FIBRES)),)),
    "viscoelastic_prestrain": Material(
        "prestrain", {"ramp": 1.0, "F0": _STRETCH}, (Material("viscoelastic", _ONE_TERM, (_SOFT,)),)
    ),
}
TIMES = (0.0, 1.0, 2.0, 3.0)  # at rest, stretched and sheared, held, after a second step
CELL, NODE = 2, 5  # those that are compared
_TIGHT = {"symmetric_stiffness": "non-symmetric", "max_refs": 50, "dtol": 1e-9, "etol": 1e-14, "rtol": 1e-9}
_NEWTON = {"qn_method": "BFGS", "max_ups": 0}


def of_law(name: str) -> LimbModel:
    """A block of ten-node tetrahedra: its top moves until 1 s, is held until 2 s, and moves back."""
    ways = {"x": 0.15, "y": -0.08, "z": 0.22}
    step = Step(n_steps=8, step_size=0.25, adaptive=False, control={**_TIGHT, **_NEWTON})
    base = tuple(Support("z0", (axis,), 0.0) for axis in "xyz")
    top = tuple(Support("z1", (axis,), way, "way") for axis, way in ways.items())
    return replace(
        block("tet10", (1, 1, 1), material=LAWS[name]),
        supports=(*base, *top),
        curves={
            "way": Curve(((0.0, 0.0), (1.0, 1.0), (2.0, 1.0), (3.0, 0.4))),
            "ramp": Curve(((0.0, 0.0), (1.0, 1.0))),
        },
        steps=(step, replace(step, n_steps=4)),
        records=(
            LogRecord("element", CELL_FIELDS, "cells.csv", np.array([CELL])),
            LogRecord("node", NODE_FIELDS, "nodes.csv", np.array([NODE])),
        ),
    )


def turning() -> LimbModel:
    """A free plate that turns by 7 rad about an axis, then by a further rotation vector, beside a block."""
    model = block("tet10", (1, 1, 1), material=_SOFT)
    first = len(model.mesh.points)
    corners = np.array([(5.0, 0, 0), (6.0, 0, 0), (6.0, 1, 0), (5.0, 1, 0)])
    plate = Block("plate", "quad4", np.arange(first, first + 4)[None])
    mesh = Mesh(
        np.concatenate([model.mesh.points, corners]), (*model.mesh.blocks, plate), model.mesh.node_sets
    )
    angles = dict(zip("uvw", (7.0 / 3, 14.0 / 3, 14.0 / 3), strict=True))
    more = dict(zip("uvw", (0.5, 0.0, -0.4), strict=True))
    held = tuple(Drive("plate", axis, "fixed") for axis in "xyz")  # type: ignore[arg-type]
    turned = tuple(Drive("plate", k, "rotation", a, "ramp") for k, a in angles.items())  # type: ignore[arg-type]
    on = tuple(Drive("plate", k, "rotation", a, "later", relative=True) for k, a in more.items())  # type: ignore[arg-type]
    step = Step(n_steps=14, step_size=0.25, adaptive=False, control={**_TIGHT, **_NEWTON})
    return replace(
        model,
        mesh=mesh,
        bodies=(RigidBody("plate", (5.5, 0.5, 0.0), ("plate",)),),
        supports=tuple(Support("z0", (axis,), 0.0) for axis in "xyz"),
        curves={"ramp": Curve(((0.0, 0.0), (3.5, 1.0))), "later": Curve(((3.5, 0.0), (4.5, 1.0)))},
        steps=(replace(step, drives=(*held, *turned)), replace(step, n_steps=4, drives=(*held, *on))),
        records=(LogRecord("rigid_body", BODY_FIELDS, "plate.csv", "plate"),),
    )


def _step(n_steps: int = 10, size: float = 0.1, *, adaptive: bool = True, **more: object) -> Step:
    keys = {"dtforce", "output_level", "output_stride"}
    asked = {name: value for name, value in more.items() if name in keys}
    rest = {name: value for name, value in more.items() if name not in keys}
    stepper = {"dt_max": 0.3, "dt_min": 0.0, "max_retries": 5, "opt_iterations": 11} if adaptive else {}
    return Step(
        n_steps=n_steps,
        step_size=size,
        adaptive=adaptive,
        control={**_TIGHT, **_NEWTON, **asked},
        **{**stepper, **rest},  # type: ignore[arg-type]
    )


_MUST = {"must_points": (0.35, 0.7), "dt_max": 0.2}
OUTPUT = {
    "growing": (_step(),),
    "forced": (_step(dtforce=1),),
    "forced by a curve": (_step(dtforce=1, dt_max_curve="sizes", must_points=(0.4, 1.0)),),
    "forced, must-points": (_step(dtforce=1, output_stride=2, **_MUST),),
    "stride": (_step(adaptive=False, output_stride=3),),
    "stride that meets the end": (_step(adaptive=False, output_stride=5),),
    "stride, two steps": (_step(adaptive=False, output_stride=4), _step(6, adaptive=False, output_stride=4)),
    "must-points": (_step(output_level="OUTPUT_MUST_POINTS", **_MUST),),
    "must-point at the end": (_step(output_level="OUTPUT_MUST_POINTS", must_points=(0.35, 1.0), dt_max=0.2),),
    "final": (_step(output_level="OUTPUT_FINAL"),),
    "final, two steps": (_step(output_level="4"), _step(4, output_level="OUTPUT_FINAL")),
    "never, then every": (_step(output_level="OUTPUT_NEVER"), _step(4, adaptive=False)),
}


def of_output(name: str, *, law: str = "ogden") -> LimbModel:
    """A block whose top is pulled, with the steps of `OUTPUT`."""
    model = of_law(law)
    curves = {
        "way": Curve(((0.0, 0.0), (1.0, 1.0), (2.0, 1.4))),
        "sizes": Curve(((0.0, 0.1), (0.4, 0.3), (1.0, 0.05))),
    }
    return replace(
        model,
        supports=tuple(each for each in model.supports if each.node_set == "z0" or each.dofs == ("z",)),
        curves=curves,
        steps=OUTPUT[name],
        records=(LogRecord("node", ("uz", "Rz"), "nodes.csv", np.array([NODE, 20])),),
    )
