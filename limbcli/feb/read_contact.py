"""`<Contact>`: contact between the soft primary surface and the secondary one."""

from __future__ import annotations

from typing import Literal, cast

from limbcli.feb.read_loads import Scene, flag
from limbcli.feb.read_mesh import ADD_TO_MESH, refuse_repeated
from limbcli.feb.xml import Tag
from limbcli.model.bodies import Contact

# FEBio's defaults of sliding-elastic for missing tags (FESlidingElasticInterface).
CONTACT_DEFAULTS = {
    "penalty": 1.0, "tolerance": 0.1, "gaptol": 0.0, "search_radius": 1.0, "fric_coeff": 0.0, "knmult": 0.0,
    "search_tol": 0.01,
}  # fmt: skip
CONTACT_MORE = (
    "seg_up", "tension", "minaug", "maxaug", "node_reloc", "smooth_aug", "flip_primary", "flip_secondary",
    "shell_bottom_primary", "shell_bottom_secondary", "offset",
    "ptol", "pressure_penalty", "contact_frac",
)  # fmt: skip


def read_contacts(tag: Tag, scene: Scene) -> tuple[Contact, ...]:
    tag.allow(many=("contact",))
    refuse_repeated(tag)
    found = []
    for each in tag:
        with each.goes_on():
            found.append(_contact(each, scene))
    return tuple(found)


def _contact(tag: Tag, scene: Scene) -> Contact:
    kind = tag.attribute("type")
    if kind not in ("sliding-elastic", "sliding-biphasic"):
        raise tag.problem(f"a contact of type {kind!r} is not supported", fix="use sliding-elastic")
    switches = ("laugon", "auto_penalty", "update_penalty", "two_pass", "symmetric_stiffness")
    tag.allow(
        attributes=("name", "type", "surface_pair"), children=(*switches, *CONTACT_DEFAULTS, *CONTACT_MORE)
    )
    pair = tag.attribute("surface_pair")
    if pair not in scene.mesh.pairs:
        raise tag.missing(f"surface pair {pair!r}", ADD_TO_MESH)
    primary, secondary = scene.mesh.pairs[pair]
    laugon = tag.child("laugon")
    numbers, curves = dict(CONTACT_DEFAULTS), dict[str, str | None]()
    for name in CONTACT_DEFAULTS:
        child = tag.child(name)
        if child is not None and name in ("penalty", "gaptol"):
            numbers[name], curves[name] = scene.number(child)
        elif child is not None:
            numbers[name] = child.number()
    return Contact(
        primary=primary,
        secondary=secondary,
        name=tag.optional("name") or pair,
        kind=cast(Literal["sliding-elastic", "sliding-biphasic"], kind),
        penalty=numbers["penalty"],
        auto_penalty=flag(tag, "auto_penalty"),
        update_penalty=flag(tag, "update_penalty"),
        augmented=laugon is not None and laugon.choice(("PENALTY", "AUGLAG", "0", "1")) in ("AUGLAG", "1"),
        tolerance=numbers["tolerance"],
        gap_tolerance=numbers["gaptol"],
        search_radius=numbers["search_radius"],
        friction=numbers["fric_coeff"],
        symmetric=flag(tag, "symmetric_stiffness", default=True),
        two_pass=flag(tag, "two_pass"),
        knmult=numbers["knmult"],
        search_tolerance=numbers["search_tol"],
        more={each.name: each.constant() for each in tag if each.name in CONTACT_MORE},
        penalty_curve=curves.get("penalty"),
        gap_tolerance_curve=curves.get("gaptol"),
    )
