"""What a file of others means otherwise than may be expected is said; of a plain model nothing is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest

from limbcli.model import Curve, LimbModel, Load, LogRecord, Step, Support
from limbcli.solvers.cautions import cautions
from tests.fem.small_models import block
from tests.solvers import logged_models

STEP = Step(n_steps=2, step_size=0.5, adaptive=False)


def plain() -> LimbModel:
    """A block that is pulled and logs the reaction where it is pulled."""
    model = block("tet4", (1, 1, 1))
    top = model.mesh.node_sets["z1"]
    return replace(
        model,
        supports=(Support("z0", ("x", "y", "z")), Support("z1", ("z",), 0.2, "ramp")),
        steps=(STEP,),
        records=(LogRecord("node", ("uz", "Rz"), "nodes.csv", top),),
    )


def with_curve(curve: Curve) -> Callable[[LimbModel], LimbModel]:
    return lambda model: replace(model, curves={"ramp": curve})


PEAK = Curve(((0.0, 0.0), (0.7, 1.0), (1.0, 0.5)))
SEEN: dict[str, tuple[Callable[[LimbModel], LimbModel], str]] = {
    "body force": (
        lambda model: replace(model, loads=(Load("body force", "", (0.0, 0.0, 1.0)),)), "against its sign"
    ),
    "put back": (
        lambda model: replace(model, steps=(STEP, replace(STEP, supports=(Support("x0", ("x",)),)))),
        "puts displaced nodes back",
    ),
    "reaction": (
        lambda model: replace(model, records=(LogRecord("node", ("Rz",), "nodes.csv", None),)), "logged as 0"
    ),
    "step": (with_curve(Curve(((0.0, 0.0), (1.0, 1.0)), "step")), "next point's value"),
    "peak": (with_curve(PEAK), "its peak at 0.7 s"),
}  # fmt: skip


def test_of_a_plain_model_nothing_is_said() -> None:
    assert cautions(plain()) == ()
    assert cautions(with_curve(replace(PEAK, points=((0.0, 0.0), (0.5, 1.0), (1.0, 0.5))))(plain())) == ()


@pytest.mark.parametrize("case", list(SEEN))
def test_what_is_seen_in_a_model_is_said_once(case: str) -> None:
    change, words = SEEN[case]
    (sentence,) = cautions(change(plain()))
    assert words in sentence


def test_rotations_about_two_axes_are_one_vector() -> None:
    found = cautions(logged_models.turning())
    assert any("components of one rotation vector" in each for each in found)


def test_a_peak_that_is_a_must_point_is_hit() -> None:
    step = replace(STEP, adaptive=True, dt_max=0.5, must_points=(0.7,))
    assert cautions(replace(with_curve(PEAK)(plain()), steps=(step,))) == ()
