"""Read a FEBio 4.0 model file as a `LimbModel`.

Everything in the file is either represented by the model or rejected with an error that names tag, line and
file. Only content that cannot change a result is ignored: names of boundary conditions and surface pairs, the
physical constants of `<Globals>` (not used for solids), and comments.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from limbcli.bodies import RigidBody
from limbcli.feb import read_loads
from limbcli.feb.info import read_info
from limbcli.feb.read_contact import read_contacts
from limbcli.feb.read_control import read_steps
from limbcli.feb.read_material import MaterialSection, read_materials
from limbcli.feb.read_mesh import MeshSection, read_mesh, read_mesh_data, refuse_repeated
from limbcli.feb.read_output import read_output
from limbcli.feb.xml import Tag, open_model
from limbcli.model import FIBRES, Curved, Domain, ElementMap, LimbModel, Material, Mesh, Step, Surface

EMPTY_NODE_SETS, EMPTY_SURFACES = "empty_node_sets", "empty_surfaces"  # keys stored with `info`
_SECTIONS = (
    "Module", "Globals", "Control", "Material", "Mesh", "MeshDomains", "MeshData", "Boundary", "Rigid",
    "Contact", "Step", "LoadData", "Output",
)  # fmt: skip


def read_feb(path: Path | str) -> LimbModel:
    """Read a model file.

    Parameters
    ----------
    path : a `.feb` or `.feb.gz` file, format 4.0, units mm-N-s

    Returns
    -------
    LimbModel with nodes and cells numbered from 0 in the file's order. Load curves keep their names
    (`curve_<id>` if they have none); a curve that only defines must-points under `<dtmax>` becomes
    `Step.must_points`.

    Raises
    ------
    CaseError
        For anything that is unknown, contradictory or not supported by the model (tag, line and file are
        named, and are in `facts`).

    Source: FEBio user manual 4, chapter 3 (free format input).
    """
    root = open_model(Path(path))
    root.allow(attributes=("version",), children=_SECTIONS)
    _check_module(root.child("Module"))
    _check_globals(root.child("Globals"))
    curves, curve_names = read_loads.read_curves(root.child("LoadData"))
    mesh = read_mesh(root.need("Mesh"))
    data = root.child("MeshData")
    element_maps, node_maps = read_mesh_data(data, mesh)
    materials = read_materials(root.need("Material"), curve_names, element_maps)
    domains, bodies = _domains(root.need("MeshDomains"), mesh, materials)
    scene = read_loads.Scene(mesh, node_maps, bodies, curve_names)
    supports, ties = read_loads.read_boundary(root.child("Boundary"), scene)
    drives, springs = read_loads.read_rigid(root.child("Rigid"), scene)
    contacts = read_contacts(root.child("Contact"), scene)
    steps, must_curves = read_steps(root, scene, curves)
    used = materials.used_maps | scene.used_maps | {FIBRES}
    read_loads.refuse_unused({**element_maps, **node_maps}, used, data)
    records, plot_variables = read_output(root.child("Output"), mesh, bodies, materials.by_id)
    info = read_info(root)
    if plot_variables:
        info["plot_variables"] = list(plot_variables)
    model = LimbModel(
        mesh=_with_empty_sets(mesh.mesh, info),
        materials=materials.materials,
        domains=domains,
        bodies=tuple(read_loads.tie(bodies, ties).values()),
        supports=supports,
        drives=drives,
        springs=springs,
        contacts=contacts,
        curves=curves,
        steps=steps,
        records=records,
        info=info,
        fibres=_fibres(element_maps),
    )
    return _without_idle_curves(model, must_curves)


def _fibres(maps: Mapping[str, ElementMap]) -> ElementMap | None:
    """The map of fibre directions if there is one, whether or not a law uses it."""
    found = maps.get(FIBRES)
    return found if found is not None and found.values.ndim == 2 else None


def _check_module(tag: Tag | None) -> None:
    if tag is None:
        return
    tag.allow(attributes=("type",), children=("units",))
    if tag.attribute("type") not in ("solid", "biphasic"):
        raise tag.problem(f"module {tag.attribute('type')!r} is not supported", fix='use type="solid"')


def _check_globals(tag: Tag | None) -> None:
    if tag is None:
        return
    tag.allow(children=("Constants",))
    constants = tag.child("Constants")
    if constants is not None:
        constants.allow(children=("T", "P", "R", "Fc"))


def _domains(
    tag: Tag, mesh: MeshSection, materials: MaterialSection
) -> tuple[tuple[Domain, ...], dict[str, RigidBody]]:
    tag.allow(many=("SolidDomain", "ShellDomain"))
    domains: list[Domain] = []
    bodies = dict(materials.bodies)
    blocks = {block.name: block for block in mesh.mesh.blocks}
    refuse_repeated(tag)
    for each in tag:
        name, material = each.attribute("name"), each.attribute("mat")
        if name not in blocks:
            raise each.problem(f"there is no <Elements> section {name!r}", fix="add it, or correct the name")
        if each.name == "SolidDomain" and not blocks[name].is_solid:
            raise each.problem(f"{name!r} holds {blocks[name].kind} shells", fix="use <ShellDomain>")
        if material in bodies:
            each.allow(attributes=("name", "mat"))
            bodies[material] = replace(bodies[material], blocks=(*bodies[material].blocks, name))
        elif material not in materials.materials:
            raise each.problem(f"there is no material {material!r}", fix="add it, or correct the name")
        elif each.name == "ShellDomain":
            raise each.problem("shells of deformable material are not supported", fix="use solid elements")
        else:
            _refuse_other_maps(each, name, materials.materials[material])
            domains.append(_solid_domain(each, name, material))
    given = {domain.block for domain in domains} | {name for body in bodies.values() for name in body.blocks}
    for name in blocks:
        if name not in given:
            raise tag.problem(f"the <Elements> section {name!r} has no domain", fix="add a domain for it")
    return tuple(domains), bodies


def _refuse_other_maps(tag: Tag, block: str, material: Material) -> None:
    """Reject maps of a domain's material whose values belong to other cells."""
    for value in material.parameters.values():
        if isinstance(value, ElementMap) and value.block != block:
            raise tag.problem(
                f"its material has a map over {value.block!r}",
                fix=f"give the map over {block!r}, or give this part a separate material",
            )
    for part in material.parts:
        _refuse_other_maps(tag, block, part)


def _solid_domain(tag: Tag, name: str, material: str) -> Domain:
    """A domain, with FEBio's element formulation if `type` or `elem_type` names one."""
    rule = tag.optional("type")
    if rule == "ut4-solid":
        tag.allow(attributes=("name", "mat", "type"), children=("alpha", "iso_stab"))
        return Domain(name, material, rule, {each.name: each.number() for each in tag})
    tag.allow(attributes=("name", "mat", "elem_type", "type"))
    if rule not in (None, "elastic-solid"):
        raise tag.problem(f"the domain type {rule!r} is not supported", fix="leave it out, or use ut4-solid")
    element = tag.optional("elem_type")
    return Domain(name, material, None if element == "default" else element)


def _without_idle_curves(model: LimbModel, must_curves: frozenset[str]) -> LimbModel:
    """Remove curves that only define must-points; the steps contain these."""
    used = used_curves(model)
    kept = {name: curve for name, curve in model.curves.items() if name in used or name not in must_curves}
    return replace(model, curves=kept)


def used_curves(model: LimbModel) -> set[str]:
    """Names of the load curves that a load, support or parameter refers to."""
    names: set[str | None] = set()
    owners: list[LimbModel | Step] = [model, *model.steps]
    for owner in owners:
        names |= {support.curve for support in owner.supports}
        names |= {drive.curve for drive in owner.drives}

    names |= {step.dt_max_curve for step in model.steps}

    def visit(material: Material) -> None:
        for value in material.parameters.values():
            names.add(value.curve if isinstance(value, Curved) else None)
        for part in material.parts:
            visit(part)

    for material in model.materials.values():
        visit(material)
    return {name for name in names if name is not None}


def _with_empty_sets(mesh: Mesh, info: dict[str, Any]) -> Mesh:
    """Add the empty sets and surfaces, which a file cannot represent."""
    nodes = {str(name): np.zeros(0, dtype=np.int64) for name in info.pop(EMPTY_NODE_SETS, ())}
    surfaces = {str(name): Surface(str(name), {}) for name in info.pop(EMPTY_SURFACES, ())}
    return replace(mesh, node_sets={**mesh.node_sets, **nodes}, surfaces={**mesh.surfaces, **surfaces})
