"""Simplifications of a model that make it converge faster, at a small change of its forces."""

from __future__ import annotations

from dataclasses import replace

from limbcli.model import LimbModel, Material

BAND = 0.05  # width of the transition in I4 over which fibres engage


def softer_jumps(model: LimbModel, band: float = BAND) -> LimbModel:
    """Let sheared fibres engage over a wider band of I4, which converges faster than an abrupt jump."""

    def soften(material: Material) -> Material:
        parts = tuple(map(soften, material.parts))
        if material.law == "fiber_exp_pow" and material.parameters.get("mu"):
            material = material.with_parameters(band=band)
        return replace(material, parts=parts) if parts else material

    return replace(model, materials={name: soften(each) for name, each in model.materials.items()})


def fewer_steps(model: LimbModel, n: int) -> LimbModel:
    """Limit the load steps of a path-dependent model to `n` equal steps.

    These are sufficient. With friction, alternating long and short steps need up to twice the work of equal
    ones.
    """
    steps = tuple(
        replace(each, n_steps=n, step_size=each.n_steps * each.step_size / n, adaptive=False)
        if each.n_steps > n
        else each
        for each in model.steps
    )
    return replace(model, steps=steps)
