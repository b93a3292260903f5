"""`<Material>`: laws converted to the model's conventions, and rigid bodies."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from limbcli.feb.law_tags import LawTag, lame, law_tags, tag_of_febio
from limbcli.feb.xml import Tag
from limbcli.model import Curved, ElementMap, Material, Value
from limbcli.model.bodies import RigidBody

_DEFAULTS = {"pressure_model": ("0", "default")}  # FEBio's own value of what laws do not have
_DEFAULT_DENSITY = 1e-9
_UNIT_TOLERANCE = 1e-12  # deviation of a length from 1 that counts as round-off; the vector is left unchanged


@dataclass(frozen=True, eq=False)
class MaterialSection:
    """without_centre : the bodies whose centre of mass FEBio computes from the mesh"""

    materials: Mapping[str, Material]
    bodies: Mapping[str, RigidBody]
    by_id: Mapping[str, str]
    used_maps: frozenset[str]
    without_centre: frozenset[str]


@dataclass(frozen=True, eq=False)
class _Names:
    curves: Mapping[str, str]
    maps: Mapping[str, ElementMap]
    used_maps: set[str] = field(default_factory=set)


def read_materials(tag: Tag, curves: Mapping[str, str], maps: Mapping[str, ElementMap]) -> MaterialSection:
    tag.allow(many=("material",))
    names = _Names(curves, maps)
    materials: dict[str, Material] = {}
    bodies: dict[str, RigidBody] = {}
    by_id: dict[str, str] = {}
    without_centre: set[str] = set()
    for number, each in enumerate(tag, start=1):
        with each.goes_on():
            if each.attribute("id") != str(number):
                raise each.problem(
                    f"id {each.attribute('id')} where {number} was expected",
                    fix="number materials from 1 without gaps",
                )
            name = each.optional("name") or f"material_{number}"
            if name in by_id.values():
                raise each.problem(f"two materials are named {name!r}", fix="name every material differently")
            by_id[str(number)] = name
            if each.attribute("type") == "rigid body":
                bodies[name], has_centre = _rigid_body(each, name)
                without_centre |= set() if has_centre else {name}
            else:
                materials[name] = _material(each, names, attributes=("id", "name", "type"))
    return MaterialSection(materials, bodies, by_id, frozenset(names.used_maps), frozenset(without_centre))


def _rigid_body(tag: Tag, name: str) -> tuple[RigidBody, bool]:
    """(body, whether the file gives its centre of mass).

    Of <override_com> and <center_of_mass> the later one decides: the latter switches the former on (FEBio,
    FERigidMaterial). E and v of a rigid body matter only for auto_penalty of a rigid primary surface, which
    is not supported here.
    """
    tag.allow(
        attributes=("id", "name", "type"), children=("density", "center_of_mass", "override_com", "E", "v")
    )
    center, given = (0.0, 0.0, 0.0), False
    for each in tag:
        if each.name == "center_of_mass":
            x, y, z = each.numbers(3)
            center, given = (x, y, z), True
        elif each.name == "override_com":
            given = each.flag()
    return RigidBody(name=name, center_of_mass=center, density=_density(tag)), given


def _density(tag: Tag) -> float:
    density = tag.child("density")
    return _DEFAULT_DENSITY if density is None else density.number()


def _material(tag: Tag, names: _Names, *, attributes: tuple[str, ...] = ("type",)) -> Material:
    law = tag_of_febio(tag.attribute("type"))
    if law is None:
        raise tag.problem(
            f"the material type {tag.attribute('type')!r} is not supported",
            fix=f"use one of: {', '.join(each.febio for each in law_tags())}, rigid body",
        )
    children = [name for name, _ in law.parameters]
    children += ["E", "v"] if law.elastic_constants else []
    children += ["fiber"] if law.fiber else []
    children += ["density"] if law.has_density else []
    children += [each.name for each in tag if each.text in _DEFAULTS.get(each.name, ())]
    children += {"prestrain": ["prestrain"], "biphasic": ["permeability"]}.get(law.law, [])
    tag.allow(attributes=attributes, children=children, many=(law.part,) if law.part else ())
    return Material(
        law=law.law,
        parameters=_parameters(tag, law, names),
        parts=_parts(tag, law, names),
        density=_density(tag) if law.has_density else _DEFAULT_DENSITY,
    )


def _parts(tag: Tag, law: LawTag, names: _Names) -> tuple[Material, ...]:
    if law.part is None:
        return ()
    parts = []
    for each in tag.all(law.part):
        with each.goes_on():
            parts.append(_material(each, names))
    if tag.all(law.part) and len(parts) < len(tag.all(law.part)):
        return ()  # what is wrong with them has been noted
    if not parts or (law.n_parts is not None and len(parts) != law.n_parts):
        raise tag.problem(
            f"it has {len(parts)} <{law.part}>, not {law.n_parts or 'one or more'}",
            fix=f"correct its <{law.part}>",
        )
    return tuple(parts)


def _parameters(tag: Tag, law: LawTag, names: _Names) -> dict[str, Value]:
    values: dict[str, Value] = {}
    for febio, ours in law.parameters:
        child = tag.child(febio)
        if child is not None:
            values[ours] = _value(child, names)
    if law.elastic_constants:
        values["mu"], values["lambda"] = _lame(tag, names)
    if law.fiber:
        values["fiber"] = _fiber(tag.need("fiber"), names)
    if law.law == "prestrain":
        values |= _prestrain(tag.need("prestrain"), names)
    if law.law == "biphasic":
        values["perm"] = _permeability(tag.need("permeability"), names)
    return values


def _value(tag: Tag, names: _Names) -> Value:
    tag.allow(attributes=("type", "lc"))
    kind, curve = tag.optional("type"), tag.optional("lc")
    if kind == "map" and curve is None:
        return _map(tag, tag.text, names)
    if kind not in (None, "const"):
        raise tag.problem(
            f"a value of type {kind!r} is not supported", fix="use a number, a map or a load curve"
        )
    value = tag.number(attributes=("lc",))
    if curve is None:
        return value
    if curve not in names.curves:
        raise tag.missing(f"load controller {curve}", "add it to <LoadData>")
    return Curved(value, names.curves[curve])


def _map(tag: Tag, name: str, names: _Names, *, vectors: bool = False) -> ElementMap:
    if name not in names.maps:
        raise tag.missing(f"element map {name!r}", "add it to <MeshData>")
    if (names.maps[name].values.ndim == 2) != vectors:
        kind = "vec3" if vectors else "scalar"
        raise tag.problem(f"the map {name!r} is not one of {kind}s", fix=f'name a map of data_type="{kind}"')
    names.used_maps.add(name)
    return names.maps[name]


def _lame(tag: Tag, names: _Names) -> tuple[Value, Value]:
    young, poisson = (_value(tag.need(name), names) for name in ("E", "v"))
    if not isinstance(young, float | ElementMap) or not isinstance(poisson, float | ElementMap):
        raise tag.problem("load curves are not supported here", fix="use numbers or maps for E and v")
    E, v = (each.values if isinstance(each, ElementMap) else np.array(each) for each in (young, poisson))
    if not ((v > -1) & (v < 0.5)).all():
        wrong = v[~((v > -1) & (v < 0.5))].ravel()[0]
        raise tag.problem(f"v = {wrong} is not between -1 and 0.5", fix="give a v below 0.5")
    if isinstance(young, float) and isinstance(poisson, float):
        return lame(young, poisson)
    maps = [each for each in (young, poisson) if isinstance(each, ElementMap)]
    if len({each.block for each in maps}) > 1:
        raise tag.problem("the maps of E and v are over different sets", fix="define both over one part")
    mu, lam = np.broadcast_arrays(*lame(E, v))
    name, block = maps[0].name, maps[0].block
    return ElementMap(f"{name}_mu", block, mu), ElementMap(f"{name}_lambda", block, lam)


def _fiber(tag: Tag, names: _Names) -> Value:
    """A unit vector, or a map of vectors."""
    kind = tag.attribute("type")
    if kind == "vector":
        tag.allow(attributes=("type",), children=("vector",))
        vector = np.array((tag.child("vector") or tag).numbers(3, attributes=("type",)))
        length = float(np.linalg.norm(vector))
        if length == 0:
            raise tag.problem("the fibre direction has no length", fix="give a direction")
        unit = vector if abs(length - 1) < _UNIT_TOLERANCE else vector / length
        return tuple(unit.tolist())
    if kind == "angles":
        tag.allow(attributes=("type",), children=("theta", "phi"))
        theta, phi = (math.radians(tag.need(name).number()) for name in ("theta", "phi"))
        return (math.cos(theta) * math.sin(phi), math.sin(theta) * math.sin(phi), math.cos(phi))
    if kind == "map":
        tag.allow(attributes=("type",), children=("map",))
        return _map(tag, (tag.child("map") or tag).text, names, vectors=True)
    raise tag.problem(f"a fibre of type {kind!r} is not supported", fix="use vector, angles or map")


def _prestrain(tag: Tag, names: _Names) -> dict[str, Value]:
    if tag.attribute("type") != "prestrain gradient":
        raise tag.problem(f"type {tag.attribute('type')!r} is not supported", fix='use "prestrain gradient"')
    tag.allow(attributes=("type",), children=("ramp", "F0"))
    ramp = tag.child("ramp")
    gradient = tag.need("F0")
    gradient.allow()
    return {"ramp": 1.0 if ramp is None else _value(ramp, names), "F0": gradient.numbers(9)}


def _permeability(tag: Tag, names: _Names) -> Value:
    if tag.attribute("type") != "perm-const-iso":
        raise tag.problem(f"type {tag.attribute('type')!r} is not supported", fix="use perm-const-iso")
    tag.allow(attributes=("type",), children=("perm",))
    return _value(tag.need("perm"), names)
