"""What a diagnosis may take more lightly than a final run."""

from __future__ import annotations

from dataclasses import replace

from limbcli.model import LimbModel, Material

BAND = 0.05  # of I4


def softer_jumps(model: LimbModel, band: float = BAND) -> LimbModel:
    """Sheared fibres come in over a wider band of I4: solved sooner than the jump itself."""

    def soften(material: Material) -> Material:
        parts = tuple(map(soften, material.parts))
        if material.law == "fiber_exp_pow" and material.parameters.get("mu"):
            material = material.with_parameters(band=band)
        return replace(material, parts=parts) if parts else material

    return replace(model, materials={name: soften(each) for name, each in model.materials.items()})


def fewer_steps(model: LimbModel, n: int) -> LimbModel:
    """What depends on the way takes every step: so many are enough for it, alike from level to level.

    Long and short steps in turn take with friction up to twice the work of steps that are alike.
    """
    steps = tuple(
        replace(each, n_steps=n, step_size=each.n_steps * each.step_size / n, adaptive=False)
        if each.n_steps > n
        else each
        for each in model.steps
    )
    return replace(model, steps=steps)
