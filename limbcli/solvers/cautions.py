"""What a model file means to FEBio 4.11 otherwise than its author may expect: one sentence for each."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from limbcli.model import Curve, LimbModel

_NEAR = 1e-7  # distance of a time step from a point of a curve that counts as hit, relative to the end time


def cautions(model: LimbModel) -> tuple[str, ...]:
    """Sentences about what is seen in a model; both solvers act as they say.

    Source: FEBio 4.11, its own runs of small models (docs/solvers.md).
    """
    return tuple(sentence for look in _LOOKS for sentence in look(model))


def _body_forces(model: LimbModel) -> Iterator[str]:
    loads = [*model.loads, *(each for step in model.steps for each in step.loads)]
    if any(each.kind == "body force" for each in loads):
        yield "a body force acts against its sign: FEBio 4.11 applies minus the acceleration that is given"


def _put_back(model: LimbModel) -> Iterator[str]:
    later = [each for step in model.steps[1:] for each in step.supports]
    if any(each.value is None and not each.relative for each in later):
        yield (
            "zero displacement in a later step puts displaced nodes back at once; to hold them there, "
            "prescribe 0 with <relative>1</relative>"
        )


def _turns(model: LimbModel) -> Iterator[str]:
    for drives in (model.drives, *(step.drives for step in model.steps)):
        turned: dict[str, set[str]] = {}
        for each in drives:
            if each.kind == "rotation" and each.value:
                turned.setdefault(each.body, set()).add(each.dof)
        for body, axes in turned.items():
            if len(axes) > 1:
                yield (
                    f"the rotations of {body!r} about {len(axes)} axes are the components of one rotation "
                    "vector, not turns that follow each other"
                )


def _reactions(model: LimbModel) -> Iterator[str]:
    fixed = [each for each in model.supports if each.value is None]
    for record in model.records:
        axes = {name[1] for name in record.fields if name[0] == "R"} if record.kind == "node" else set()
        nodes = [model.mesh.node_sets[each.node_set] for each in fixed if axes & set(each.dofs)]
        held = np.unique(np.concatenate([np.zeros(0, dtype=np.int64), *nodes]))
        logged = held if record.items is None else np.intersect1d(held, record.items)
        if len(logged):
            yield (
                f"record {record.file!r}: the reaction of the {len(logged)} nodes under zero displacement is "
                "logged as 0; prescribe a displacement of 0 where it is wanted"
            )


def _curves(model: LimbModel) -> Iterator[str]:
    from limbcli.fem.equilibrium.solve_times import step_times

    times, begin = [0.0], 0.0
    for step in model.steps:
        if step.dt_max_curve is None:
            times += step_times(step, begin=begin, every=True)
        else:  # its sizes are not known here: only must-points and the end
            times += step_times(step, begin=begin)
        begin = times[-1]
    for name, curve in model.curves.items():
        if curve.formula is not None or name in {step.dt_max_curve for step in model.steps}:
            continue
        if curve.interpolate == "step" and len(curve.points) > 1:
            yield f"load curve {name!r} of type STEP has the next point's value as soon as a point is reached"
        missed = [t for t in _peaks(curve) if t < begin and _distance(t, times) > _NEAR * begin]
        if missed and not any(step.dt_max_curve for step in model.steps):
            yield (
                f"load curve {name!r} has its peak at {missed[0]:g} s between two time steps, which do not "
                "reach it: make it a must-point of <dtmax>"
            )


def _peaks(curve: Curve) -> list[float]:
    """Times of the inner points at which the curve turns.

    >>> _peaks(Curve(((0.0, 0.0), (1.0, 2.0), (2.0, 1.0), (3.0, 0.5))))
    [1.0]
    """
    values = np.array([value for _, value in curve.points])
    turns = np.flatnonzero(np.diff(values[:-1]) * np.diff(values[1:]) < 0) + 1
    return [curve.points[k][0] for k in turns]


def _distance(time: float, times: list[float]) -> float:
    return float(np.abs(np.array(times) - time).min())


_LOOKS = (_body_forces, _put_back, _turns, _reactions, _curves)
