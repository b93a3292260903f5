"""`<LoadData>`, `<Boundary>` and `<Rigid>`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal, cast

from limbcli.errors import SolveError
from limbcli.feb.ids import Amount
from limbcli.feb.read_mesh import MeshSection
from limbcli.feb.xml import Tag
from limbcli.model import Curve, NodeMap, Support
from limbcli.model.bodies import Drive, RigidBody, Spring

_INTERPOLATIONS = ("linear", "step", "smooth")
_EXTENSIONS = ("constant", "extrapolate", "repeat", "repeat offset")
_DISPLACEMENTS = ("x", "y", "z")
_CONDITIONS = {
    "zero displacement": tuple(f"{dof}_dof" for dof in _DISPLACEMENTS),
    "prescribed displacement": ("dof", "value", "relative"),
    "zero fluid pressure": (),
    "rigid": ("rb", "clamp_shells"),
}
_OF_SHELLS = ("zero rotation", "zero shell displacement")
_RIGID_DOFS = {"Rx": "x", "Ry": "y", "Rz": "z", "Ru": "u", "Rv": "v", "Rw": "w"}


@dataclass(frozen=True, eq=False)
class Scene:
    """What loads refer to: the mesh, the node maps, the bodies, and curves and materials by id."""

    mesh: MeshSection
    node_maps: Mapping[str, NodeMap]
    bodies: Mapping[str, RigidBody]
    curves: Mapping[str, str]
    materials: Mapping[str, str] = field(default_factory=dict)
    used_maps: set[str] = field(default_factory=set)

    def curve(self, tag: Tag) -> str | None:
        name = tag.optional("lc")
        if name is None:
            return None
        if name not in self.curves:
            raise tag.missing(f"load controller {name}", "add it to <LoadData>")
        return self.curves[name]

    def body(self, tag: Tag) -> str:
        """The rigid body, named or given by its material's id (FEBio, FEFileSection::parseEnumParam)."""
        name = self.materials.get(tag.text, tag.text) if tag.text.isdigit() else tag.text
        if name not in self.bodies:
            named = f"name one of {', '.join(sorted(self.bodies))}, or " if self.bodies else ""
            raise tag.missing(f"rigid body {tag.text!r}", f"{named}add a material of the type rigid body")
        return name

    def number(self, tag: Tag) -> tuple[float, str | None]:
        """A number, and the load curve that multiplies it."""
        tag.allow(attributes=("lc",))
        return tag.number(attributes=("lc",)), self.curve(tag)

    def amounts(self, tag: Tag, count: int) -> tuple[tuple[Amount, ...], str | None]:
        """Numbers or formulas, and the load curve that multiplies them."""
        tag.allow(attributes=("lc", "type"))
        return tag.amounts(count, attributes=("lc",)), self.curve(tag)


# ---------------------------------------------------------------- LoadData


def read_curves(tag: Tag) -> tuple[dict[str, Curve], dict[str, str]]:
    """(curves by name, names by id)."""
    curves: dict[str, Curve] = {}
    by_id: dict[str, str] = {}
    tag.allow(many=("load_controller",))
    for number, each in enumerate(tag, start=1):
        with each.goes_on():
            name, curve = _controller(each, number)
            if name in curves:
                raise each.problem(f"two load controllers are named {name!r}", fix="name them differently")
            curves[name] = curve
            by_id[str(number)] = name
    return curves, by_id


def _controller(tag: Tag, number: int) -> tuple[str, Curve]:
    if tag.attribute("id") != str(number):
        raise tag.problem(
            f"id {tag.attribute('id')} where {number} was expected",
            fix="number load controllers from 1 without gaps",
        )
    if tag.attribute("type") == "math":
        return tag.optional("name") or f"curve_{number}", _formula_of_time(tag)
    if tag.attribute("type") != "loadcurve":
        raise tag.problem(f"type {tag.attribute('type')!r} is not supported", fix="use a loadcurve or math")
    tag.allow(attributes=("id", "name", "type"), children=("interpolate", "extend", "points"))
    return tag.optional("name") or f"curve_{number}", _curve(tag)


def _formula_of_time(tag: Tag) -> Curve:
    tag.allow(attributes=("id", "name", "type"), children=("math",))
    formula = tag.need("math")
    formula.allow()
    return Curve((), formula=formula.formula(formula.text, ("t",)))


def _curve(tag: Tag) -> Curve:
    interpolate, extend = tag.child("interpolate"), tag.child("extend")
    kind = interpolate.choice(_INTERPOLATIONS) if interpolate else "linear"
    points = tag.need("points")
    points.allow(many=("pt", "point"))
    pairs: list[tuple[float, float]] = []
    for each in points:
        each.allow()
        time, value = each.numbers(2)
        if pairs and time < pairs[-1][0]:
            raise each.problem("its time is before the point above", fix="sort the points by time")
        pairs.append((time, value))
    if not pairs:
        raise points.problem("there is no point", fix="add <pt>time,value</pt>")
    if kind == "smooth" and len({time for time, _ in pairs}) < len(pairs):
        raise points.problem(
            "a smooth curve has two points at one time", fix="keep one of them, or use LINEAR"
        )
    return Curve(
        points=tuple(pairs),
        interpolate=cast(Literal["linear", "step", "smooth"], kind),
        extend=cast(
            Literal["constant", "extrapolate", "repeat", "repeat offset"],
            extend.choice(_EXTENSIONS) if extend else "constant",
        ),
    )


# ---------------------------------------------------------------- Boundary


def read_boundary(tag: Tag, scene: Scene) -> tuple[tuple[Support, ...], list[tuple[str, str]]]:
    """(supports, (body, node set) for each node set that is tied to a rigid body)."""
    supports: list[Support] = []
    ties: list[tuple[str, str]] = []
    tag.allow(many=("bc",))
    for each in tag:
        with each.goes_on():
            _boundary_condition(each, scene, supports, ties)
    return tuple(supports), ties


def _boundary_condition(tag: Tag, scene: Scene, supports: list[Support], ties: list[tuple[str, str]]) -> None:
    kind = tag.attribute("type")
    if kind in _OF_SHELLS:
        tag.ignore(f"boundary conditions of type {kind!r}, as there are no deformable shells")
        return
    if kind not in _CONDITIONS:
        raise tag.problem(
            f"a boundary condition of type {kind!r} is not supported",
            fix="use zero displacement, prescribed displacement or rigid",
        )
    tag.allow(attributes=("name", "type", "node_set"), children=_CONDITIONS[kind])
    node_set = scene.mesh.node_set(tag, tag.attribute("node_set"))
    if kind == "zero displacement":
        supports.append(Support(node_set, _switched_on(tag, _DISPLACEMENTS)))
    elif kind == "prescribed displacement":
        supports.append(_prescribed(tag, node_set, scene))
    elif kind == "zero fluid pressure":
        supports.append(Support(node_set, ("p",)))
    else:
        ties.append((scene.body(tag.need("rb")), node_set))


def _switched_on(tag: Tag, names: tuple[str, ...]) -> tuple[str, ...]:
    chosen = tuple(name for name in names if flag(tag, f"{name}_dof"))
    if not chosen:
        raise tag.problem("no degree of freedom is chosen", fix=f"switch on one of {list(names)}")
    return chosen


def _prescribed(tag: Tag, node_set: str, scene: Scene) -> Support:
    value = tag.need("value")
    value.allow(attributes=("lc", "type"))
    amount: float | NodeMap
    if value.optional("type") == "map":
        if value.text not in scene.node_maps:
            raise value.problem(f"there is no node map {value.text!r}", fix="add it to <MeshData>")
        scene.used_maps.add(value.text)
        amount = scene.node_maps[value.text]
        if amount.node_set != node_set:
            raise value.problem(
                f"the map is over the node set {amount.node_set!r}", fix=f"give it over {node_set!r}"
            )
    elif value.optional("type") == "math":
        amount = _map_of_formula(tag, value, node_set, scene)
    elif value.optional("type") in (None, "const"):
        amount = value.number(attributes=("lc",))
    else:
        raise value.problem(
            f"type {value.optional('type')!r} is not supported", fix="use a number, a formula or a map"
        )
    return Support(
        node_set=node_set,
        dofs=(tag.need("dof").choice(_DISPLACEMENTS),),
        value=amount,
        curve=scene.curve(value),
        relative=flag(tag, "relative"),
    )


def _map_of_formula(tag: Tag, value: Tag, node_set: str, scene: Scene) -> NodeMap:
    """The values of a formula of X, Y, Z at the nodes of a set, under a name that no map has."""
    formula = value.formula(value.text, ("X", "Y", "Z"))
    mesh = scene.mesh.mesh
    name = f"{tag.optional('name') or node_set}_by_formula_line_{value.line}"
    try:
        return NodeMap(name, node_set, formula(mesh.points[mesh.node_sets[node_set]], 0.0))
    except SolveError as error:
        raise value.problem(error.what, fix="correct the formula") from error


def flag(tag: Tag, name: str, *, default: bool = False) -> bool:
    child = tag.child(name)
    return default if child is None else child.flag()


# ---------------------------------------------------------------- Rigid


def read_rigid(tag: Tag, scene: Scene) -> tuple[tuple[Drive, ...], tuple[Spring, ...]]:
    drives: list[Drive] = []
    springs: list[Spring] = []
    tag.allow(many=("rigid_bc", "rigid_load", "rigid_connector"))
    for each in tag:
        with each.goes_on():
            kind = each.attribute("type")
            if kind == "rigid_fixed":
                drives += _fixed(each, scene)
            elif kind in ("rigid_displacement", "rigid_rotation", "rigid_force", "rigid_moment"):
                drives.append(_driven(each, scene, kind.removeprefix("rigid_")))
            elif kind == "rigid_rotation_vector":
                drives += _rotation_vector(each, scene)
            elif kind == "rigid spring":
                springs.append(_spring(each, scene))
            else:
                raise each.problem(
                    f"type {kind!r} is not supported",
                    fix="use rigid_fixed, rigid_ displacement, rotation, rotation_vector, force or moment, "
                    "or a rigid spring",
                )
    return tuple(drives), tuple(springs)


def _fixed(tag: Tag, scene: Scene) -> list[Drive]:
    tag.allow(attributes=("name", "type"), children=("rb", *(f"{name}_dof" for name in _RIGID_DOFS)))
    body = scene.body(tag.need("rb"))
    names = _switched_on(tag, tuple(_RIGID_DOFS))
    return [Drive(body, _RIGID_DOFS[name], "fixed") for name in names]  # type: ignore[arg-type]


def _driven(tag: Tag, scene: Scene, kind: str) -> Drive:
    children = ["rb", "dof", "value", "relative"]
    if kind in ("force", "moment"):
        children.append("load_type")
        load_type = tag.child("load_type")
        if load_type is not None and load_type.constant() not in ("LOAD", "0"):
            raise load_type.problem(f"{load_type.text!r} is not supported", fix="use LOAD")
    tag.allow(attributes=("name", "type"), children=children)
    value, curve = scene.number(tag.need("value"))
    turns = kind in ("rotation", "moment")
    dofs = {name: dof for name, dof in _RIGID_DOFS.items() if (dof in "uvw") == turns}
    if kind == "displacement":
        dofs = {dof: dof for dof in _DISPLACEMENTS}
    return Drive(
        body=scene.body(tag.need("rb")),
        dof=_dof(tag.need("dof"), dofs, by_number=kind in ("force", "moment")),  # type: ignore[arg-type]
        kind=cast(Literal["displacement", "rotation", "force", "moment"], kind),
        value=value,
        curve=curve,
        relative=flag(tag, "relative"),
    )


def _rotation_vector(tag: Tag, scene: Scene) -> list[Drive]:
    """The components of a rotation vector (rad); one that is not given is 0 (FERigidRotationVector)."""
    tag.allow(attributes=("name", "type"), children=("rb", "vx", "vy", "vz"))
    body = scene.body(tag.need("rb"))
    drives = []
    for name, dof in (("vx", "u"), ("vy", "v"), ("vz", "w")):
        child = tag.child(name)
        value, curve = (0.0, None) if child is None else scene.number(child)
        drives.append(Drive(body, dof, "rotation", value, curve))  # type: ignore[arg-type]
    return drives


def _dof(tag: Tag, dofs: Mapping[str, str], *, by_number: bool) -> str:
    """A degree of freedom by its name; FEBio takes those of forces and moments also by number, from 0."""
    names = tuple(dofs)
    if by_number and tag.text in ("0", "1", "2"):
        return dofs[names[int(tag.text)]]
    return dofs[tag.choice(names)]


def _spring(tag: Tag, scene: Scene) -> Spring:
    tag.allow(
        attributes=("name", "type"),
        children=("body_a", "body_b", "k", "insertion_a", "insertion_b", "free_length"),
    )
    a, b = (tag.need(name).numbers(3) for name in ("insertion_a", "insertion_b"))
    return Spring(
        name=tag.optional("name") or "spring",
        body_a=scene.body(tag.need("body_a")),
        body_b=scene.body(tag.need("body_b")),
        stiffness=tag.need("k").number(),
        insertion_a=(a[0], a[1], a[2]),
        insertion_b=(b[0], b[1], b[2]),
        free_length=tag.need("free_length").number(),
    )


def tie(bodies: Mapping[str, RigidBody], ties: list[tuple[str, str]]) -> dict[str, RigidBody]:
    """The bodies with the node sets that are tied to them."""
    tied = dict(bodies)
    for body, node_set in ties:
        tied[body] = replace(tied[body], node_sets=(*tied[body].node_sets, node_set))
    return tied
