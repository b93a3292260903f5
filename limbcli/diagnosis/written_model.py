"""The model that a diagnosis writes: the site's own, with the chosen effects and the refitted parameters."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from limbcli.diagnosis.explanations.conclusions import Diagnosis
from limbcli.diagnosis.forward_model.site_forward_model import SiteForwardModel
from limbcli.diagnosis.mesh_error.mesh_correction import F_KAPPA, own_layers
from limbcli.diagnosis.prepare import Prepared
from limbcli.effects.curves import Curves, force_at
from limbcli.effects.effect import applied
from limbcli.effects.reading import true_depth
from limbcli.feb.settings import LEAST_START, USUAL_PENALTY, schedule
from limbcli.feb.write import write_feb
from limbcli.model import Array
from limbcli.model.npz_file import load_model
from limbcli.numbers.units import mpa_from_kpa
from limbcli.results import StageWriter, data_if_there, read_result
from limbcli.site_model.indentation_model import indentation_model, starting_depth, with_penalty

_SOFT = 0.02  # relative reduction of the force by the written model's contact above which a warning is given


def write_diagnosed(
    found: Diagnosis, forward_model: SiteForwardModel, mine: Prepared, writer: StageWriter, *, out: Path,
    number: int,
    templates: Path | None = None,
) -> None:  # fmt: skip
    """Write the site's own model with the chosen effects and the refitted parameters as diagnosed.feb;
    differences from the diagnosis become warnings. number : index of the site in the forward model"""
    path = out / "mesh" / mine.site.name / "model.npz"
    if not path.is_file():
        writer.warnings.append("no .feb was written: the site has not been meshed (limbcli mesh)")
        return
    if layers := own_layers(mine.site, out):
        writer.warnings.append(
            f"no .feb was written: the site's mesh has {layers} as well as the tissue, but the diagnosis "
            "does not (limbcli mesh without layers)"
        )
        return
    fitted = found.final
    curves, reading = forward_model.curves_of(fitted, number)
    depth = true_depth(curves, mine.curves.site.protocol.depth, reading)
    # the probe travels further than the tissue is indented, by the support's compliance
    travel = np.unique(np.round(depth + reading.compliance * force_at(curves, depth), 3))
    depths = [float(each) for each in travel if each > 2 * LEAST_START]
    meshed = load_model(path)
    plan = schedule(depths, start=starting_depth(meshed, depths[0]))
    c = mpa_from_kpa(fitted.values["c_kpa"])
    built = data_if_there(out, "build-feb", site=mine.site.name).get("contact_penalty")
    penalty = float(built) if isinstance(built, int | float) else USUAL_PENALTY
    model = indentation_model(meshed, plan, c=c, f_kappa=F_KAPPA, m=fitted.values["m"])
    model = with_penalty(model, penalty)
    theta = forward_model.theta(fitted.values, fitted.explanation, number)
    added = []
    for name, point in forward_model.model_of(fitted):
        each = forward_model.effects[name]
        added.append((each, {**each.null, **theta, **each.without_onset(point)}))
        if point.get(each.onset, 0.0) > 0.0:
            writer.warnings.append(
                f"diagnosed.feb has {name} from the start; in the data it begins after "
                f"{100 * point[each.onset]:.0f} % of the levels"
            )
    write_feb(applied(model, added), writer.file("feb", "diagnosed.feb"), templates)
    force = curves.force * mine.simulations.c / c
    if warning := _contact_takes(mine, curves, force, float(depth.max()), penalty, out=out):
        writer.warnings.append(warning)


def _contact_takes(
    mine: Prepared, curves: Curves, force: Array, deep: float, penalty: float, *, out: Path
) -> str | None:
    """Warning if the written model's contact lowers the fitted force at its deepest level by more than
    `_SOFT`; force (n,) : of the curves, at the reference stiffness"""
    known = mine.curves.penetration
    if known is None:
        return None
    # The effect of a penalty depends on the facet size.
    meshed = read_result(out, "mesh", site=mine.site.name).data
    edge = float(meshed.get("size_under_probe_mm", mine.size))
    required = penalty * mine.size / edge / mine.simulations.model.contacts[0].penalty
    taken = known.taken(curves, force, deep, penalty=required)
    if taken <= _SOFT:
        return None
    return (
        f"diagnosed.feb has the contact penalty of the site's model, {penalty:g}: the probe penetrates "
        f"the skin, which lowers the force at {deep:.1f} mm by about {100 * taken:.0f} % compared with "
        "the diagnosis (build-feb --contact-penalty)"
    )
