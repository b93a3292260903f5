"""Contacts in which FEBio finds no force: auto_penalty on a rigid primary surface without volume.

FEBio scales the penalty with area / volume of the element behind a facet of the primary surface, and with E
of its material (that of a rigid body is 1 unless given). It takes 0 for the whole if the volume is 0, as in
rigid shells without thickness, or E is 0; then the run ends normally with a force of exactly 0.

Source: FEBio 4.11, FEContactInterface::AutoPenalty, FERigidMaterial.
"""

from __future__ import annotations

from typing import cast

from lxml import etree

from limbcli.feb.xml import Tag

_SHELLS = ("tri", "quad")


def contacts_without_force(root: Tag) -> tuple[str, ...]:
    """A sentence about each of them; also of models that `read_feb` refuses."""
    bodies = _rigid_parts(root)
    return tuple(
        f"contact {each.optional('name') or each.optional('surface_pair')!r}: its primary surface "
        f"{primary!r} is on rigid shells without volume, for which FEBio's auto_penalty gives no force at all"
        for each in (Tag(contact, root.file) for contact in root.element.iter("contact"))
        if _is_on(each, "auto_penalty")
        and not _is_on(each, "two_pass")
        and (primary := _primary(root, each.optional("surface_pair") or ""))
        and _nodes_of_surface(root, primary) <= bodies
    )


def _is_on(tag: Tag, name: str) -> bool:
    child = tag.child(name)
    return child is not None and child.text not in ("", "0")


def _primary(root: Tag, pair: str) -> str | None:
    for each in root.element.iterfind("Mesh/SurfacePair"):
        if each.get("name") == pair:
            return (each.findtext("primary") or "").strip() or None
    return None


def _nodes_of_surface(root: Tag, name: str) -> set[str]:
    """Ids of its nodes; an unknown or empty surface yields one that no element has."""
    for each in root.element.iterfind("Mesh/Surface"):
        if each.get("name") == name:
            found = {word.strip() for facet in each for word in (facet.text or "").split(",")}
            return found or {""}
    return {""}


def _rigid_parts(root: Tag) -> set[str]:
    """Ids of the nodes of rigid elements without penalty of their own, and of no other element."""
    materials = {
        each.get("name"): _number(each.findtext("E"), 1.0) != 0  # with a penalty of its own
        for each in root.element.iterfind("Material/material")
        if each.get("type") == "rigid body"
    }
    thick = {
        each.get("elem_set")
        for each in root.element.iterfind("MeshData/ElementData")
        if each.get("type") == "shell thickness"
    }
    domains = {each.get("name"): each for each in root.element.iterfind("MeshDomains/*")}
    rigid: set[str] = set()
    other: set[str] = set()
    for part in root.element.iterfind("Mesh/Elements"):
        domain = domains.get(part.get("name"))
        mat = domain.get("mat") if domain is not None else None
        shell = (part.get("type") or "").lower().startswith(_SHELLS) and part.get("name") not in thick
        flat = domain is not None and shell and _number(domain.findtext("shell_thickness"), 0.0) == 0
        if domain is not None and mat in materials and (flat or not materials[mat]):
            rigid |= _words(part)
        else:
            other |= _words(part)
    return rigid - other


def _number(text: str | None, default: float) -> float:
    try:
        return float(text) if text is not None else default
    except ValueError:
        return default


def _words(part: etree._Element) -> set[str]:
    texts = cast(list[str], part.xpath("elem/text()"))
    return {word.strip() for text in texts for word in text.split(",")}
