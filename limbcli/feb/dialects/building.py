"""Building blocks of the conversions: new elements at an old one's line."""

from __future__ import annotations

from collections.abc import Iterable

from lxml import etree

from limbcli.feb.xml import Tag


def new(
    tag: str, like: etree._Element, text: str | None = None, /, **attributes: str | None
) -> etree._Element:
    """An element, said to be in the line of `like`; attributes that are None are left out."""
    made = etree.Element(tag, {key: value for key, value in attributes.items() if value is not None})
    made.sourceline = like.sourceline
    made.text = text
    return made


def add(owner: etree._Element, name: str, like: etree._Element, text: str | None = None) -> etree._Element:
    made = new(name, like, text)
    owner.append(made)
    return made


def moved(element: etree._Element, name: str, *, drop: Iterable[str] = ()) -> etree._Element:
    """The same element under another name, without the attributes in `drop`."""
    element.tag = name
    for key in drop:
        taken(element, key)
    return element


def taken(element: etree._Element, key: str) -> str | None:
    """An attribute's value, which is taken out; None if there is none."""
    return str(element.attrib.pop(key)) if key in element.attrib else None


def split(text: str) -> list[str]:
    return [word.strip() for word in text.split(",") if word.strip()]


def set_ids(element: etree._Element, names: Iterable[str]) -> None:
    """Ids given as children <n id=""/> as a list between commas; a list that is there already stays."""
    rows = [each for each in element if each.tag in names]
    if rows and len(rows) == len(element) and all(each.get("id") for each in rows):
        ids = ",".join(str(each.get("id")) for each in rows)
        for each in rows:
            element.remove(each)
        element.text = ids


def step_owners(root: Tag) -> list[etree._Element]:
    """The file itself and its steps: where <Control>, <Boundary> and <Rigid> may be."""
    return [root.element, *root.element.iterfind("Step/step")]
