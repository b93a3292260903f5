"""Several effects in one model."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from limbcli.effects import effect
from limbcli.effects.effect import applied
from limbcli.effects.reading import Reading
from limbcli.effects.tissue import TISSUE, core
from limbcli.materials import compile_material
from limbcli.model import ElementMap, Material
from tests.diagnosis.reduced import block_model

FAT = (effect("adipose-layer"), {"log_fat_softness": 1.0, "fat_thickness_mm": 8.0})
SKIN = (effect("skin-layer"), {"log_skin_ratio": 3.0, "skin_thickness_mm": 1.5})
BALL = (
    effect("inclusion"),
    {
        "log_inclusion_ratio": 1.5,
        "inclusion_x_mm": 0.0,
        "inclusion_depth_mm": 8.0,
        "inclusion_radius_mm": 8.0,
    },
)
STEEPER = (effect("nonlinearity"), {"weight_q": 0.5, "second_pair_share": 0.1, "second_exponent": 12.0})
TENSED = (effect("contraction"), {"active_stress_per_c": 1.0})


def ground(model) -> np.ndarray:
    """c of every cell (n_cells,)."""
    values = (value for name, value in core(model.materials[TISSUE]).parameters.items() if name in CS)
    n = len(model.mesh.block("tissue").cells)
    return sum(np.broadcast_to(v.values if isinstance(v, ElementMap) else float(v), n) for v in values)


CS = tuple(f"c{k}" for k in range(1, 7))


@pytest.mark.parametrize(
    ("layered", "other"), itertools.product((FAT, SKIN, BALL), (STEEPER, TENSED)), ids=lambda e: e[0].name
)
def test_stiffer_and_softer_places_keep_their_ratio_beside_any_other_effect(layered, other):
    """The mean of c over all cells, put into every cell, had taken them away."""
    model = block_model()
    alone = ground(applied(model, [layered]))
    both, turned = applied(model, [layered, other]), applied(model, [other, layered])
    assert np.ptp(alone) > 1e-3
    assert ground(both) == pytest.approx(alone)
    assert ground(turned) == pytest.approx(alone)


def test_what_is_told_in_terms_of_c_is_of_the_tissues_c():
    """Tension of once c beside fat is as it is without, but for the fat itself."""
    model = block_model()
    tension = applied(model, [FAT, TENSED]).materials[TISSUE].parts[1].parameters["T0"].values
    assert tension.max() == pytest.approx(0.006)
    assert tension.min() == pytest.approx(0.006 / np.e, rel=0.02)


RELAXING = (effect("viscoelasticity"), {"relaxing_share": 0.3, "relaxation_time_s": 10.0})
FIBRES = (effect("anisotropy"), {"fibre_shear_per_c": 1.0, "fibre_tension_per_c": 0.5, "fibre_exponent": 0.0})
DRAINING = (effect("poroelasticity"), {"log_permeability_ratio": 5.5, "drained_f_kappa": 2.0})


def tree(material: Material) -> str:
    return f"{material.law}({' '.join(sorted(map(tree, material.parts)))})"


def test_a_second_share_relaxes_a_decade_later_and_is_fitted_where_holds_are_recorded():
    relaxing, _ = RELAXING
    both = {"relaxing_share": 0.3, "second_relaxing_share": 0.2, "relaxation_time_s": 1.0}
    law = applied(block_model(), ((relaxing, both),)).materials[TISSUE]
    assert compile_material(law, TISSUE).prony == (1.0, ((0.3, 1.0), (0.2, 10.0)))
    assert relaxing.observe(Reading(), both).prony == ((0.3, 1.0), (0.2, 10.0))
    assert relaxing.observe(Reading(), {**both, "relaxing_share": 0.0}).prony == ((0.2, 10.0),)
    told = [p.name for p in relaxing.measured_by(("force", "hold")).parameters]
    assert told == ["relaxing_share", "second_relaxing_share"]
    assert [p.name for p in relaxing.measured_by(("force", "swe")).parameters] == ["relaxing_share"]


@pytest.mark.parametrize("others", [(FIBRES,), (FIBRES, TENSED), (STEEPER, DRAINING), (FIBRES, DRAINING)])
def test_all_of_the_tissue_relaxes_and_drains_in_whatever_order_effects_come(others):
    """Fibres that came after relaxation had stood beside it: not relaxing, and in no law of our solver."""
    orders = itertools.permutations((RELAXING, *others))
    made = [applied(block_model(), order).materials[TISSUE] for order in orders]
    assert len(set(map(tree, made))) == 1
    found = made[0]
    if DRAINING in others:
        assert found.law == "biphasic"
        (found,) = found.parts
    assert found.law == "viscoelastic"
    prony = compile_material(found, TISSUE).prony
    assert prony == (1.0, ((0.3, 10.0),))
