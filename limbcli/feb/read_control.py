"""`<Control>` and `<Step>`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal, cast

from limbcli.feb.read_distributed_loads import read_distributed_loads
from limbcli.feb.read_loads import Scene, read_boundary, read_rigid
from limbcli.feb.xml import Tag, drop_empty
from limbcli.model import Curve, Step

# FEBio's defaults for missing tags in <time_stepper> (FETimeStepController).
STEPPER_DEFAULTS = {"max_retries": 5, "opt_iter": 11, "dtmin": 0.0}
_TEXT, _WHOLE, _REAL = "text", "whole", "real"
STEPPER_DT_MAX = 0.1
STEPPER_MORE = {"aggressiveness": _WHOLE, "cutback": _REAL, "dtforce": _WHOLE}
SOLVER = {
    **dict.fromkeys(("symmetric_stiffness", "equation_scheme", "equation_order"), _TEXT),
    **dict.fromkeys(("optimize_bw", "max_refs"), _WHOLE),
    **dict.fromkeys(("dtol", "etol", "rtol", "ptol", "lstol", "lsmin"), _REAL),
    **dict.fromkeys(("lsiter", "ls_check_jacobians"), _WHOLE),
    **dict.fromkeys(("min_residual", "max_residual", "zero_diagonal_tol"), _REAL),
    **dict.fromkeys(("check_zero_diagonal", "force_partition", "logSolve", "arc_length"), _WHOLE),
    **dict.fromkeys(("diverge_reform", "reform_each_time_step", "reform_augment"), _WHOLE),
    **dict.fromkeys(("rhoi", "alpha", "beta", "gamma", "arc_length_scale"), _REAL),
}
QUASI_NEWTON = {"max_ups": _WHOLE, "max_buffer_size": _WHOLE, "cycle_buffer": _WHOLE, "cmax": _REAL}
OUTPUT_CONTROL = {
    "plot_level": _TEXT, "plot_range": _TEXT, "plot_zero_state": _WHOLE, "plot_stride": _WHOLE,
    "output_level": _TEXT, "output_stride": _WHOLE, "adaptor_re_solve": _WHOLE,
}  # fmt: skip
# FEBio's numbering of output levels (FEAnalysis, FE_Output_Level).
OUTPUT_LEVELS = (
    "OUTPUT_NEVER", "OUTPUT_MAJOR_ITRS", "OUTPUT_MINOR_ITRS", "OUTPUT_MUST_POINTS", "OUTPUT_FINAL",
)  # fmt: skip
MAJOR, MUST_POINTS, FINAL = 1, 3, 4  # the first is the default: every time step
_OF_STEP = ("Control", "Boundary", "Loads", "Rigid")
_TIME_DIGITS = 12


@dataclass(frozen=True, eq=False)
class _Context:
    """What a step refers to, and its start time."""

    scene: Scene
    curves: Mapping[str, Curve]
    start: float
    must_curves: set[str]
    materials: Tag


def read_steps(
    root: Tag, scene: Scene, curves: Mapping[str, Curve]
) -> tuple[tuple[Step, ...], frozenset[str]]:
    """(steps, names of the curves that only define must-points).

    Global times of must-points are converted to times from the start of their step.
    """
    control, several = root.child("Control"), root.child("Step")
    context = _Context(scene, curves, 0.0, set(), root.need("Material"))
    if several is None or several.is_empty:
        if control is None:
            raise root.problem("there is neither <Control> nor <Step>", fix="add <Control>")
        return (_step(control, None, context),), frozenset(context.must_curves)
    if control is not None:
        raise control.problem(
            "a global <Control> together with <Step> is not supported", fix="keep the one in each step"
        )
    several.allow(many=("step",))
    steps: list[Step] = []
    for each in several:
        drop_empty(each, _OF_STEP)
        each.allow(attributes=("id", "name", "type"), children=_OF_STEP)
        steps.append(_step(each.need("Control"), each, context))
        end = context.start + steps[-1].n_steps * steps[-1].step_size
        context = replace(context, start=round(end, _TIME_DIGITS))
    if not steps:
        raise several.problem("there is no <step> in it", fix="add one")
    return tuple(steps), frozenset(context.must_curves)


def _step(tag: Tag, owner: Tag | None, context: _Context) -> Step:
    tag.allow(children=("analysis", "time_steps", "step_size", "time_stepper", "solver", *OUTPUT_CONTROL))
    analysis = tag.child("analysis")
    stepper = tag.child("time_stepper")
    control = _solver(tag.need("solver")) | _settings(tag, OUTPUT_CONTROL)
    # as FEBio does
    level, stride = tag.child("output_level"), tag.child("output_stride")
    if level is not None and output_level(level.text) is None:
        raise level.problem(
            f"{level.text!r} is not an output level", fix=f"use one of: {', '.join(OUTPUT_LEVELS)}"
        )
    if stride is not None:
        _positive(stride)
    fields: dict[str, Any] = {"adaptive": False}
    if stepper is not None:
        fields, more = _stepper(stepper, context)
        control |= more
    loads = _loads(owner, context) if owner else {}
    given = analysis.choice(("STATIC", "TRANSIENT", "DYNAMIC")) if analysis else "STATIC"
    kind = "static" if given == "STATIC" else "transient"  # FEBio's DYNAMIC is another name of TRANSIENT
    return Step(
        n_steps=_positive(tag.need("time_steps")).integer(),
        step_size=_positive(tag.need("step_size")).number(),
        analysis=cast(Literal["static", "transient"], kind),
        control=control,
        **loads,
        **fields,
    )


def output_level(text: str) -> int | None:
    """The number of an output level, which FEBio takes by name or number; None: it has no such level.

    >>> output_level("OUTPUT_FINAL"), output_level("3"), output_level("ALWAYS")
    (4, 3, None)
    """
    names = [*OUTPUT_LEVELS, *map(str, range(len(OUTPUT_LEVELS)))]
    return names.index(text.upper()) % len(OUTPUT_LEVELS) if text.upper() in names else None


def _positive(tag: Tag) -> Tag:
    if tag.number() <= 0:
        raise tag.problem(f"{tag.text!r} is not positive", fix="give a number above 0")
    return tag


def _loads(owner: Tag, context: _Context) -> dict[str, Any]:
    """Supports, drives and loads that are active during one step only."""
    scene = context.scene
    loads = read_distributed_loads(owner.section("Loads"), scene, context.materials)
    supports, ties = read_boundary(owner.section("Boundary"), scene)
    drives, springs = read_rigid(owner.section("Rigid"), scene)
    if ties or springs:
        raise owner.problem(
            "ties to rigid bodies and springs inside a step are not supported",
            fix="move them out of the step",
        )
    return {"supports": supports, "drives": drives, "loads": loads}


def _stepper(tag: Tag, context: _Context) -> tuple[dict[str, Any], dict[str, Any]]:
    tag.allow(attributes=("type",), children=(*STEPPER_DEFAULTS, "dtmax", *STEPPER_MORE))
    if tag.optional("type") not in (None, "default"):
        raise tag.problem(f"type {tag.optional('type')!r} is not supported", fix='use type="default"')
    values: dict[str, Any] = dict(STEPPER_DEFAULTS)
    values |= _settings(tag, {"max_retries": _WHOLE, "opt_iter": _WHOLE, "dtmin": _REAL})
    fields = {
        "max_retries": values["max_retries"],
        "opt_iterations": values["opt_iter"],
        "dt_min": values["dtmin"],
        **_largest_step(tag.child("dtmax"), context),
    }
    more = _settings(tag, STEPPER_MORE)
    if more.get("dtforce") and not fields["dt_max"] > 0:
        raise tag.need("dtmax").problem(
            "<dtforce> makes it every time step, but it is not positive", fix="give a number above 0"
        )
    return fields, more


def _largest_step(tag: Tag | None, context: _Context) -> dict[str, Any]:
    """The points of a load curve under <dtmax> become must-points, and its values the largest step.

    Source: FEBio, FETimeStepController::Init and AutoTimeStep (the number in <dtmax> is then ignored).
    """
    if tag is None:
        return {"dt_max": STEPPER_DT_MAX}
    tag.allow(attributes=("lc",))
    name = context.scene.curve(tag)
    if name is None:
        return {"dt_max": tag.number()}
    curve = context.curves[name]
    if curve.formula is not None:
        raise tag.problem("its load curve is a formula", fix="use a curve of points, or a number")
    if curve.extend != "constant":
        raise tag.problem(
            "its load curve must have constant extension", fix="write <extend>CONSTANT</extend>"
        )
    start = context.start
    times = tuple(round(time - start, _TIME_DIGITS) if start else time for time, _ in curve.points)
    found: dict[str, Any] = {
        "dt_max": max(value for _, value in curve.points),
        "must_points": tuple(dict.fromkeys(time for time in times if time > 0)),
    }
    if len({value for _, value in curve.points}) > 1:
        found["dt_max_curve"] = name
    else:
        context.must_curves.add(name)
    return found


def _solver(tag: Tag) -> dict[str, Any]:
    if tag.optional("type") not in (None, "solid", "biphasic"):
        raise tag.problem(f"solver type {tag.optional('type')!r} is not supported", fix='use type="solid"')
    tag.allow(attributes=("type",), children=(*SOLVER, "qn_method", "linear_solver"))
    settings = _settings(tag, SOLVER)
    linear = tag.child("linear_solver")
    if linear is not None:
        linear.allow(attributes=("type",))
        settings["linear_solver"] = linear.attribute("type")
    method = tag.child("qn_method")
    if method is not None:
        method.allow(attributes=("type",), children=QUASI_NEWTON)
        settings["qn_method"] = method.attribute("type")
        settings |= _settings(method, QUASI_NEWTON)
    return settings


def _settings(tag: Tag, kinds: Mapping[str, str]) -> dict[str, Any]:
    settings: dict[str, Any] = {}
    for child in tag:
        kind = kinds.get(child.name)
        if kind is None:
            continue
        child.allow()
        if kind == _TEXT:
            settings[child.name] = child.text
        else:
            settings[child.name] = child.integer() if kind == _WHOLE else child.number()
    return settings
