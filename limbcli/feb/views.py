"""The model in the form that the templates need: formatted rows, and plain views of materials and steps."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from markupsafe import Markup

from limbcli.errors import CaseError
from limbcli.feb.ids import Ids, number, vector
from limbcli.feb.law_tags import LawTag, law_tags, tag_of_law, young
from limbcli.feb.read_control import OUTPUT_CONTROL, QUASI_NEWTON, SOLVER, STEPPER_MORE
from limbcli.model import (
    Array,
    Block,
    Curved,
    ElementMap,
    IntArray,
    LimbModel,
    LogRecord,
    Material,
    Step,
    Surface,
    Value,
)
from limbcli.model.bodies import Drive

Row = tuple[str, tuple[tuple[str, str], ...], str | Markup]

# ---------------------------------------------------------------- mesh


def node_rows(points: Array) -> Markup:
    if not np.isfinite(points).all():
        raise CaseError("a node has no finite position", where="model mesh", fix="mesh again")
    return Markup(
        "\n".join(
            f'<node id="{k}">{x!r},{y!r},{z!r}</node>' for k, (x, y, z) in enumerate(points.tolist(), start=1)
        )
    )


def block_rows(blocks: Sequence[Block]) -> list[dict[str, Any]]:
    views = []
    count = itertools.count(1)
    for block in blocks:
        rows = (
            f'<elem id="{next(count)}">{",".join(map(str, cell))}</elem>'
            for cell in (block.cells + 1).tolist()
        )
        views.append({"name": block.name, "kind": block.kind, "rows": Markup("\n".join(rows))})
    return views


def surface_rows(surface: Surface) -> Markup:
    count = itertools.count(1)
    return Markup(
        "\n".join(
            f'<{kind} id="{next(count)}">{",".join(map(str, facet))}</{kind}>'
            for kind, facets in surface.facets.items()
            for facet in (facets + 1).tolist()
        )
    )


def set_ids(numbers: IntArray) -> str:
    return ",".join(map(str, (numbers + 1).tolist()))


def map_rows(values: Array, tag: str) -> Markup:
    table = values.reshape(len(values), -1).tolist()
    return Markup(
        "\n".join(f'<{tag} lid="{k}">{vector(row)}</{tag}>' for k, row in enumerate(table, start=1))
    )


# ---------------------------------------------------------------- materials


@dataclass(frozen=True)
class MaterialView:
    """rows: (tag, attributes, text); tag: that of a part ("solid", "elastic")."""

    tag: str
    type: str
    rows: tuple[Row, ...]
    parts: tuple[MaterialView, ...] = ()
    id: int = 0
    name: str = ""


def material_views(model: LimbModel, ids: Ids) -> list[MaterialView]:
    views = []
    for name, material in model.materials.items():
        view = _material(material, ids)
        views.append(MaterialView("material", view.type, view.rows, view.parts, ids.materials[name], name))
    for body in model.bodies:
        rows: tuple[Row, ...] = (
            ("density", (), number(body.density)),
            ("center_of_mass", (), vector(body.center_of_mass)),
        )
        views.append(MaterialView("material", "rigid body", rows, (), ids.materials[body.name], body.name))
    return views


def _material(material: Material, ids: Ids, tag: str = "material") -> MaterialView:
    law = tag_of_law(material.law)
    if law is None:
        raise CaseError(
            f"the law {material.law!r} cannot be written for FEBio",
            where="model",
            fix="give the law FEBio's names, febio=FebioNames(...), or use one of "
            + ", ".join(each.law for each in law_tags()),
        )
    rows: list[Row] = [("density", (), number(material.density))] if law.has_density else []
    rows += _scalar_rows(material, law, ids)
    if law.fiber:
        rows.append(_fiber_row(material.parameters["fiber"]))
    if law.law == "prestrain":
        text = Markup("").join(
            _xml(_value_row(name, material.parameters[name], ids)) for name in ("ramp", "F0")
        )
        rows.append(("prestrain", (("type", "prestrain gradient"),), text))
    if law.law == "biphasic":
        perm = _xml(_value_row("perm", material.parameters["perm"], ids))
        rows.append(("permeability", (("type", "perm-const-iso"),), perm))
    parts = tuple(_material(part, ids, law.part or "solid") for part in material.parts)
    return MaterialView(tag, law.febio, tuple(rows), parts)


def _scalar_rows(material: Material, law: LawTag, ids: Ids) -> list[Row]:
    values = dict(material.parameters)
    rows: list[Row] = []
    if law.elastic_constants:
        mu, lam = values.pop("mu"), values.pop("lambda")
        rows = [_value_row(name, each, ids) for name, each in zip("Ev", _young(mu, lam), strict=True)]
    for febio, ours in law.parameters:
        if ours in values:
            rows.append(_value_row(febio, values.pop(ours), ids))
    unknown = set(values) - {"fiber", "ramp", "F0", "perm"}
    if unknown:
        raise CaseError(
            f"the law {law.law} has no parameter {sorted(unknown)}", where="model", fix="correct the material"
        )
    return rows


def _young(mu: Value, lam: Value) -> tuple[Value, Value]:
    if isinstance(mu, ElementMap) and isinstance(lam, ElementMap):
        E, v = young(mu.values, lam.values)
        return ElementMap(f"{mu.name}_E", mu.block, E), ElementMap(f"{mu.name}_v", mu.block, v)
    if isinstance(mu, float | int) and isinstance(lam, float | int):
        return young(float(mu), float(lam))
    raise CaseError(
        "mu and lambda must both be numbers or both maps", where="model", fix="correct the material"
    )


def _value_row(name: str, value: Value, ids: Ids) -> Row:
    if isinstance(value, ElementMap):
        return name, (("type", "map"),), value.name
    if isinstance(value, Curved):
        return name, (("lc", str(ids.curves[value.curve])),), number(value.value)
    if isinstance(value, tuple):
        return name, (), vector(value)
    return name, (), number(value)


def _xml(row: Row) -> Markup:
    name, attributes, text = row
    inside = "".join(f' {key}="{value}"' for key, value in attributes)
    return Markup(f"<{name}{inside}>") + text + Markup(f"</{name}>")


def _fiber_row(value: Value) -> Row:
    if isinstance(value, ElementMap):
        return "fiber", (("type", "map"),), _xml(("map", (), value.name))
    if not isinstance(value, tuple):
        raise CaseError("a fibre must be a direction or a map", where="model", fix="correct the material")
    return "fiber", (("type", "vector"),), _xml(("vector", (), vector(value)))


# ---------------------------------------------------------------- steps, drives, records


def step_views(model: LimbModel, ids: Ids) -> list[dict[str, Any]]:
    return [_step(step, curve, ids) for step, curve in zip(model.steps, ids.must_curves, strict=True)]


def _step(step: Step, must_curve: str | None, ids: Ids) -> dict[str, Any]:
    known = {*SOLVER, *QUASI_NEWTON, *OUTPUT_CONTROL, *STEPPER_MORE, "qn_method", "linear_solver"}
    unknown = set(step.control) - known
    if unknown:
        raise CaseError(
            f"FEBio's settings {sorted(unknown)} are not supported here",
            where="model step",
            fix=f"use {sorted(known)}",
        )

    def chosen(names: Iterable[str]) -> list[tuple[str, str]]:
        settings = [(name, step.control[name]) for name in names if name in step.control]
        return [(name, each if isinstance(each, str) else number(each)) for name, each in settings]

    return {
        "analysis": step.analysis,
        "n_steps": step.n_steps,
        "step_size": step.step_size,
        "adaptive": step.adaptive,
        "max_retries": step.max_retries,
        "opt_iterations": step.opt_iterations,
        "dt_min": step.dt_min,
        "dt_max": step.step_size if step.dt_max is None else step.dt_max,
        "must_id": ids.curves[must_curve] if must_curve is not None else None,
        "solver": chosen(SOLVER),
        "qn_method": step.control.get("qn_method"),
        "linear_solver": step.control.get("linear_solver"),
        "quasi_newton": chosen(QUASI_NEWTON),
        "output": chosen(OUTPUT_CONTROL),
        "stepper": chosen(STEPPER_MORE),
        "has_loads": bool(step.supports or step.drives or step.loads),
        "supports": step.supports,
        "drives": drive_groups(step.drives),
        "loads": step.loads,
    }


def drive_groups(drives: Sequence[Drive]) -> list[list[Drive]]:
    """Groups of drives that share a tag: fixed degrees of freedom of one body, in FEBio's order; others
    separately."""
    groups: list[list[Drive]] = []
    for drive in drives:
        last = groups[-1][-1] if groups else None
        joins = (
            last is not None
            and drive.kind == last.kind == "fixed"
            and drive.body == last.body
            and "xyzuvw".index(drive.dof) > "xyzuvw".index(last.dof)
        )
        if joins:
            groups[-1].append(drive)
        else:
            groups.append([drive])
    return groups


def record_view(record: LogRecord, ids: Ids) -> dict[str, str]:
    if isinstance(record.items, str):
        items = str(ids.materials[record.items])
    else:
        items = "" if record.items is None else set_ids(record.items)
    return {
        "tag": f"{record.kind}_data",
        "fields": ";".join(record.fields),
        "file": record.file,
        "name": record.items if isinstance(record.items, str) else "",
        "ids": items,
    }
