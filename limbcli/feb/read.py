"""Read a FEBio 4.0 model file as a `LimbModel`.

Everything in the file is either represented by the model or rejected with an error that names tag, line and
file; one error tells all that is rejected. Only content that cannot change a result is ignored: names of
boundary conditions and surface pairs, the physical constants of `<Globals>` (not used for solids), comments,
empty sections, output that limbcli does not read, and maps that nothing uses (listed in `info`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from limbcli.feb import read_loads
from limbcli.feb.dialects import convert
from limbcli.feb.ids import parameter_values
from limbcli.feb.info import read_info
from limbcli.feb.notes import ReadingNotes
from limbcli.feb.read_contact import read_contacts
from limbcli.feb.read_control import read_steps
from limbcli.feb.read_distributed_loads import read_distributed_loads
from limbcli.feb.read_material import MaterialSection, read_materials
from limbcli.feb.read_mesh import DEFAULT_RULES, MeshSection, read_mesh, read_mesh_data, refuse_repeated
from limbcli.feb.read_output import read_output
from limbcli.feb.rigid_centres import with_centres
from limbcli.feb.units import scaled, units_scale
from limbcli.feb.xml import UNITS, Tag, drop_empty, open_model, units_of
from limbcli.materials.laws import is_three_field
from limbcli.model import FIBRES, Array, Curved, Domain, ElementMap, LimbModel, Material, Step, Surface
from limbcli.model.bodies import RigidBody

IGNORED = "ignored"  # key in `info` of what was left out, since it cannot change a result; not written
_OF_SHELLS = ("shell_thickness", "shell_normal_nodal")
EMPTY_NODE_SETS, EMPTY_SURFACES = "empty_node_sets", "empty_surfaces"  # keys stored with `info`
_SECTIONS = (
    "Module", "Globals", "Control", "Material", "Mesh", "MeshDomains", "MeshData", "Boundary", "Rigid",
    "Loads", "Contact", "Step", "LoadData", "Output",
)  # fmt: skip


def read_feb(path: Path | str) -> LimbModel:
    """Read a model file.

    Parameters
    ----------
    path : a `.feb` or `.feb.gz` file, format 4.0, or 2.5 or 3.0, which are converted; in any of FEBio's unit
        systems, which are scaled to mm-N-s

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
    notes = ReadingNotes()
    root = open_model(Path(path), notes)
    units = units_of(root)
    scale = units_scale(root)
    convert(root)
    model, must_curves = None, frozenset[str]()
    with root.goes_on():
        model, must_curves = _read(root)
    notes.raise_refused(root.file)
    assert model is not None
    if units != UNITS:
        model = scaled(model, *scale)
    if notes.ignored:
        model = replace(model, info={**model.info, IGNORED: list(notes.ignored)})
    # curves that only define must-points are left out, as the steps contain these
    used = used_curves(model)
    kept = {name: curve for name, curve in model.curves.items() if name in used or name not in must_curves}
    return replace(model, curves=kept)


def _read(root: Tag) -> tuple[LimbModel, frozenset[str]]:
    """The model of a file of format 4.0, in the file's units, and the curves that only define must-points."""
    drop_empty(root, _SECTIONS)
    root.allow(attributes=("version",), children=_SECTIONS)
    with root.goes_on():
        _check_module(root.child("Module"))
    with root.goes_on():
        root.section("Globals").allow(children=("Constants",))
    curves, curve_names = read_loads.read_curves(root.section("LoadData"))
    mesh = read_mesh(root.need("Mesh"))
    element_maps, node_maps, thicknesses = read_mesh_data(root.section("MeshData"), mesh)
    materials = read_materials(root.need("Material"), curve_names, element_maps)
    domains, bodies = _domains(root.need("MeshDomains"), mesh, materials)
    _refuse_joined(root.need("MeshDomains"), bodies, mesh)
    thicknesses = {**_thicknesses(root.need("MeshDomains"), mesh), **thicknesses}
    bodies = with_centres(bodies, materials.without_centre, mesh.mesh, thicknesses)
    scene = read_loads.Scene(mesh, node_maps, bodies, curve_names, materials.by_id)
    supports, ties = read_loads.read_boundary(root.section("Boundary"), scene)
    drives, springs = read_loads.read_rigid(root.section("Rigid"), scene)
    loads = read_distributed_loads(root.section("Loads"), scene, root.need("Material"))
    contacts = read_contacts(root.section("Contact"), scene)
    steps, must_curves = read_steps(root, scene, curves)
    for name in {*element_maps, *node_maps} - (materials.used_maps | scene.used_maps | {FIBRES}):
        root.ignore(f"map {name!r}, which nothing uses")
    records, plot_variables = read_output(root.section("Output"), mesh, bodies, materials.by_id)
    info = read_info(root)
    if plot_variables:
        info["plot_variables"] = list(plot_variables)
    # a file cannot represent empty sets and surfaces
    nodes = {str(name): np.zeros(0, dtype=np.int64) for name in info.pop(EMPTY_NODE_SETS, ())}
    surfaces = {str(name): Surface(str(name), {}) for name in info.pop(EMPTY_SURFACES, ())}
    found = replace(
        mesh.mesh, node_sets={**mesh.mesh.node_sets, **nodes}, surfaces={**mesh.mesh.surfaces, **surfaces}
    )
    fibres = element_maps.get(FIBRES)  # whether or not a law uses them
    model = LimbModel(
        mesh=found, materials=materials.materials, domains=domains,
        bodies=tuple(read_loads.tie(bodies, ties).values()), supports=supports, drives=drives,
        springs=springs, contacts=contacts, curves=curves, steps=steps, records=records, info=info,
        fibres=fibres if fibres is not None and fibres.values.ndim == 2 else None, loads=loads,
    )  # fmt: skip
    return model, must_curves


def _check_module(tag: Tag | None) -> None:
    if tag is None:
        return
    tag.allow(attributes=("type",), children=("units",))
    if tag.attribute("type") not in ("solid", "biphasic"):
        raise tag.problem(f"the module {tag.attribute('type')!r} is not supported", fix='use type="solid"')


def _domains(
    tag: Tag, mesh: MeshSection, materials: MaterialSection
) -> tuple[tuple[Domain, ...], dict[str, RigidBody]]:
    tag.allow(many=("SolidDomain", "ShellDomain"))
    domains: list[Domain] = []
    bodies = dict(materials.bodies)
    refuse_repeated(tag)
    for each in tag:
        with each.goes_on():
            domains += _domain(each, mesh, materials, bodies)
    given = {each.optional("name") for each in tag}
    for block in mesh.mesh.blocks:
        if block.name not in given:
            raise tag.problem(
                f"the <Elements> section {block.name!r} has no domain", fix="add a domain for it"
            )
    return tuple(domains), bodies


def _refuse_joined(tag: Tag, bodies: Mapping[str, RigidBody], mesh: MeshSection) -> None:
    """Refuse rigid bodies that share nodes: FEBio makes one body of them (FERigidSystem::CreateObjects)."""
    owner: dict[int, str] = {}
    for body in bodies.values():
        cells = [block.cells.ravel() for block in mesh.mesh.blocks if block.name in body.blocks]
        for node in np.unique(np.concatenate(cells)).tolist() if cells else []:
            if (other := owner.setdefault(node, body.name)) != body.name:
                raise tag.problem(
                    f"the rigid bodies {other!r} and {body.name!r} share nodes, so that FEBio joins them",
                    fix="give their parts one rigid material, or each its own nodes",
                )


def _thicknesses(tag: Tag, mesh: MeshSection) -> dict[str, Array]:
    """<shell_thickness> of whole parts, for each of their cells."""
    given = {each.optional("name"): each.child("shell_thickness") for each in tag.all("ShellDomain")}
    return {
        block.name: np.full(len(block.cells), found.number())
        for block in mesh.mesh.blocks
        if (found := given.get(block.name)) is not None
    }


def _domain(
    tag: Tag, mesh: MeshSection, materials: MaterialSection, bodies: dict[str, RigidBody]
) -> list[Domain]:
    """The domain of a deformable part; a rigid one is added to its body in `bodies`."""
    name, material = tag.attribute("name"), tag.attribute("mat")
    block = next((each for each in mesh.mesh.blocks if each.name == name), None)
    if block is None:
        raise tag.missing(f"<Elements> section {name!r}")
    if tag.name == "SolidDomain" and not block.is_solid:
        raise tag.problem(f"{name!r} holds {block.kind} shells", fix="use <ShellDomain>")
    if material in bodies:  # rigid: neither formulation nor integration matters
        tag.allow(attributes=("name", "mat", "type", "elem_type"), children=_OF_SHELLS)
        bodies[material] = replace(bodies[material], blocks=(*bodies[material].blocks, name))
        return []
    if material not in materials.materials:
        raise tag.missing(f"material {material!r}")
    if tag.name == "ShellDomain":
        raise tag.problem("shells of deformable material are not supported", fix="use solid elements")
    _refuse_other_maps(tag, name, materials.materials[material])
    three_field = is_three_field(materials.materials[material].law, block.kind)
    return [_solid_domain(tag, name, material, mesh.rules.get(name), three_field)]


def _refuse_other_maps(tag: Tag, block: str, material: Material) -> None:
    """Reject maps of a domain's material whose values belong to other cells."""
    for value in parameter_values(material):
        if isinstance(value, ElementMap) and value.block != block:
            raise tag.problem(
                f"its material has a map over {value.block!r}",
                fix=f"give the map over {block!r}, or give this part a separate material",
            )


def _solid_domain(tag: Tag, name: str, material: str, of_elements: str | None, three_field: bool) -> Domain:
    """A domain, with FEBio's element formulation if `type` or `elem_type` names one.

    of_elements : the integration rule that the type of its <Elements> section names
    three_field : whether FEBio uses its three-field element unless another is named
    """
    rule = tag.optional("type")
    if rule == "ut4-solid":
        tag.allow(attributes=("name", "mat", "type"), children=("alpha", "iso_stab"))
        return Domain(name, material, rule, {each.name: each.number() for each in tag})
    tag.allow(attributes=("name", "mat", "elem_type", "type"))
    if rule not in (None, "elastic-solid") and not (rule == "three-field-solid" and three_field):
        raise tag.problem(f"the domain type {rule!r} is not supported", fix="leave it out, or use ut4-solid")
    element = tag.optional("elem_type")
    element = of_elements if element in (None, "default") else element
    if element in DEFAULT_RULES:
        element = "elastic-solid" if rule == "elastic-solid" and three_field else None
    return Domain(name, material, element)


def used_curves(model: LimbModel) -> set[str]:
    """Names of the load curves that a load, support or parameter refers to."""
    names: set[str | None] = set()
    owners: list[LimbModel | Step] = [model, *model.steps]
    for owner in owners:
        names |= {support.curve for support in owner.supports}
        names |= {drive.curve for drive in owner.drives}
        names |= {load.curve for load in owner.loads}
    names |= {step.dt_max_curve for step in model.steps}
    for material in model.materials.values():
        names |= {value.curve for value in parameter_values(material) if isinstance(value, Curved)}
    return {name for name in names if name is not None}
