"""`<Loads>`: pressure, traction and forces on surfaces, forces on nodes, body forces; by number or formula.

FEBio's body force is that of an accelerated frame: it acts against the given direction, with the density of
the material, 1 where none is given (FEElasticSolidDomain::BodyForce, FESolidMaterial).

Source: FEBio 4.11, FEPressureLoad, FETractionLoad, FESurfaceForceUniform, FENodalForce, FENodalDOFLoad,
FEGenericBodyForce.
"""

from __future__ import annotations

from collections.abc import Callable

from limbcli.feb.ids import Amount, against
from limbcli.feb.read_loads import Scene, flag
from limbcli.feb.read_mesh import ADD_TO_MESH
from limbcli.feb.xml import Tag
from limbcli.model import Load
from limbcli.numbers.math_expressions import Formula

_AXES = ("x", "y", "z")
_KNOWN = (
    "pressure, traction, force, nodal_force, nodal_load, body forces of type const, non-const or body force"
)


def read_distributed_loads(tag: Tag, scene: Scene, materials: Tag) -> tuple[Load, ...]:
    """The loads of a section.

    materials : the <Material> section, in which a body force needs densities
    """
    tag.allow(many=("surface_load", "nodal_load", "body_load"))
    loads: list[Load] = []
    for each in tag:
        with each.goes_on():
            read = _READERS.get((each.name, each.attribute("type")))
            if read is None:
                raise each.problem(
                    f"a {each.name.replace('_', ' ')} of type {each.attribute('type')!r} is not supported",
                    fix=f"use {_KNOWN}, or run the file with FEBio (--solver febio)",
                )
            found = [load for load in read(each, scene) if any(load.value)]
            if found and each.name == "body_load":
                for material in materials:
                    if material.child("density") is None and material.optional("type") != "rigid body":
                        raise each.problem(
                            f"the material in line {material.line} has no <density>, for which FEBio takes 1",
                            fix="give every material its <density>",
                        )
            loads += found
    return tuple(loads)


def _pressure(tag: Tag, scene: Scene) -> list[Load]:
    tag.allow(
        attributes=("name", "type", "surface"),
        children=("pressure", "linear", "symmetric_stiffness", "shell_bottom"),
    )
    amount, curve = scene.amounts(tag.need("pressure"), 1)
    return [Load("pressure", _surface(tag, scene), amount, curve, flag(tag, "linear"))]


def _traction(tag: Tag, scene: Scene) -> list[Load]:
    tag.allow(
        attributes=("name", "type", "surface"), children=("scale", "traction", "linear", "shell_bottom")
    )
    vector, scale = tag.need("traction"), tag.child("scale")
    vector.allow(attributes=("type",))
    (factor,), curve = ((1.0,), None) if scale is None else scene.amounts(scale, 1)
    value = tuple(_times(factor, each) for each in vector.amounts(3))
    return [Load("traction", _surface(tag, scene), value, curve, flag(tag, "linear"))]


def _force(tag: Tag, scene: Scene) -> list[Load]:
    """A force that is spread evenly over the undeformed area of a surface."""
    tag.allow(attributes=("name", "type", "surface"), children=("scale", "force", "shell_bottom"))
    vector, scale = tag.need("force"), tag.child("scale")
    vector.allow(attributes=("type",))
    factor = 1.0
    if scale is not None:
        scale.allow(attributes=("lc", "type"))
        factor = scale.number(attributes=("lc",))
    x, y, z = (factor * each for each in vector.numbers(3))
    curve = scene.curve(scale) if scale is not None else None
    return [Load("surface force", _surface(tag, scene), (x, y, z), curve, on_reference=True)]


def _times(factor: Amount, value: Amount) -> Amount:
    if not isinstance(factor, Formula) and not isinstance(value, Formula):
        return factor * value
    texts = [each.text if isinstance(each, Formula) else repr(each) for each in (factor, value)]
    return value if texts[0] == "1.0" else Formula("*".join(f"({each})" for each in texts))


def _surface(tag: Tag, scene: Scene) -> str:
    """The name of the surface that a load is on."""
    _refuse_flag(tag, "shell_bottom", "shells of deformable material are not supported")
    name = tag.attribute("surface")
    if name not in scene.mesh.mesh.surfaces:
        raise tag.missing(f"surface {name!r}", ADD_TO_MESH)
    return name


def _nodal_force(tag: Tag, scene: Scene) -> list[Load]:
    tag.allow(attributes=("name", "type", "node_set"), children=("value", "relative", "shell_bottom"))
    force, curve = scene.amounts(tag.need("value"), 3)
    return [Load("nodal force", _nodes(tag, scene), force, curve)]


def _nodal_load(tag: Tag, scene: Scene) -> list[Load]:
    tag.allow(attributes=("name", "type", "node_set"), children=("dof", "scale", "relative"))
    dof = tag.need("dof").choice(_AXES)
    (amount,), curve = scene.amounts(tag.need("scale"), 1)
    force = tuple(amount if axis == dof else 0.0 for axis in _AXES)
    return [Load("nodal force", _nodes(tag, scene), force, curve)]


def _nodes(tag: Tag, scene: Scene) -> str:
    """The name of the node set that a load is on."""
    _refuse_flag(tag, "shell_bottom", "shells of deformable material are not supported")
    _refuse_flag(tag, "relative", "a force relative to the one before is not supported")
    return scene.mesh.node_set(tag, tag.attribute("node_set"))


def _const(tag: Tag, scene: Scene) -> list[Load]:
    """A body force whose components have a curve each; those with the same curve are one load."""
    tag.allow(attributes=("name", "type", "elem_set"), children=_AXES)
    by_curve: dict[str | None, list[Amount]] = {}
    for k, axis in enumerate(_AXES):
        child = tag.child(axis)
        if child is not None:
            (amount,), curve = scene.amounts(child, 1)
            if amount:
                by_curve.setdefault(curve, [0.0] * 3)[k] = -amount
    block = _block(tag, scene)
    return [Load("body force", block, tuple(value), curve) for curve, value in by_curve.items()]


def _body_force(tag: Tag, scene: Scene) -> list[Load]:
    tag.allow(attributes=("name", "type", "elem_set"), children=("force",))
    force, curve = scene.amounts(tag.need("force"), 3)
    return [Load("body force", _block(tag, scene), tuple(against(force)), curve)]


def _block(tag: Tag, scene: Scene) -> str:
    name = tag.optional("elem_set")
    return "" if name is None else scene.mesh.block_of(tag, name)


def _refuse_flag(tag: Tag, name: str, why: str) -> None:
    child = tag.child(name)
    if child is not None and child.flag():
        raise child.problem(why, fix="switch it off, or run the file with FEBio (--solver febio)")


_READERS: dict[tuple[str, str], Callable[[Tag, Scene], list[Load]]] = {
    ("surface_load", "pressure"): _pressure, ("surface_load", "traction"): _traction,
    ("surface_load", "force"): _force, ("nodal_load", "nodal_force"): _nodal_force,
    ("nodal_load", "nodal_load"): _nodal_load, ("body_load", "const"): _const,
    ("body_load", "non-const"): _const, ("body_load", "body force"): _body_force,
}  # fmt: skip
