"""Parse XML that others wrote: without a document type, of limited size and depth, no text overlooked.

A document type declares entities and default attributes, which may expand without limit or bring in other
files; no format that is read here has one. It is refused before anything in it is expanded.
"""

from __future__ import annotations

from typing import Any

from lxml import etree

LARGEST = 1_000_000_000  # bytes of a document
DEEPEST = 256  # elements inside each other
_STEP = 65536  # bytes
_RESOURCE_LIMIT = etree.ErrorTypes.ERR_RESOURCE_LIMIT


class XmlError(ValueError):
    """The document cannot be parsed, has a document type, or exceeds a limit."""


def parsed_xml(content: bytes, *, recover: bool = False, remove_pis: bool = False) -> etree._Element:
    """The root of a document; nothing is fetched, and no entity but XML's own five is known.

    recover : continue after errors of syntax
    remove_pis : join the text before and after a processing instruction

    Raises XmlError if it is no XML, has a document type, is larger than `LARGEST` or deeper than `DEEPEST`.

    >>> parsed_xml(b"<a>1 <!-- one --> 2</a>").tag
    'a'
    >>> parsed_xml(b"<!DOCTYPE a [<!ENTITY x '9'>]><a b='&x;'/>")  # doctest: +ELLIPSIS
    Traceback (most recent call last):
    limbcli.files.xml.XmlError: it has a document type (<!DOCTYPE a>); ...
    """
    if len(content) > LARGEST:
        raise XmlError(f"it is larger than {LARGEST / 1e9:g} GB")
    _refuse_document_type(content)
    try:
        root = _parse(content, recover=recover, remove_pis=remove_pis, huge_tree=False)
    except etree.XMLSyntaxError as error:
        if error.code != _RESOURCE_LIMIT:  # type: ignore[attr-defined]
            raise XmlError(str(error)) from error
        root = _long_texts(content, remove_pis=remove_pis)
    if root is None:
        raise XmlError("it is not XML")
    return root


def own_text(element: etree._Element) -> str:
    """All text directly in an element: also after a comment or another element in it.

    >>> own_text(parsed_xml(b"<a>1 <!-- one --> 2<b>3</b> 4</a>"))
    '1  2 4'
    """
    return (element.text or "") + "".join(each.tail or "" for each in element)


def mixed_text(root: etree._Element) -> tuple[etree._Element, str] | None:
    """The first element that contains other elements and text beside them, and that text; else None."""
    found = root.xpath("(//*[*]/text()[normalize-space()])[1]")
    if not isinstance(found, list) or not found:
        return None
    text = found[0]
    beside: etree._Element = text.getparent()  # type: ignore[union-attr,assignment]
    owner = beside.getparent() if text.is_tail else beside  # type: ignore[union-attr]
    return (beside if owner is None else owner), str(text).strip()


def _parse(content: bytes, *, recover: bool, remove_pis: bool, huge_tree: bool) -> etree._Element | None:
    parser = etree.XMLParser(
        resolve_entities=False, no_network=True, load_dtd=False, recover=recover, remove_pis=remove_pis,
        huge_tree=huge_tree,
    )  # fmt: skip
    return etree.fromstring(content, parser)


def _long_texts(content: bytes, *, remove_pis: bool) -> etree._Element | None:
    """Parse without libxml2's limits (10 MB a text, 256 levels), and check the depth."""
    try:
        root = _parse(content, recover=False, remove_pis=remove_pis, huge_tree=True)
    except etree.XMLSyntaxError as error:
        raise XmlError(str(error)) from error
    if root is not None and root.xpath(f"boolean(//*[count(ancestor::*) >= {DEEPEST}])"):
        raise XmlError(f"its elements are more than {DEEPEST} deep")
    return root


class _Begun(Exception):
    pass


class _Start:
    """A target of the parser that looks no further than the first element."""

    def doctype(self, name: str, *_: str | None) -> None:
        what = f"it has a document type (<!DOCTYPE {name[:40]}>)"
        raise XmlError(f"{what}; entities and defaults that a file defines are not supported")

    def start(self, *_: object) -> None:
        raise _Begun

    def close(self) -> None:
        return None


def _refuse_document_type(content: bytes) -> None:
    target: Any = _Start()
    parser = etree.XMLParser(target=target, resolve_entities=False, no_network=True, load_dtd=False)
    try:
        for at in range(0, len(content), _STEP):
            parser.feed(content[at : at + _STEP])
        parser.close()
    except (_Begun, etree.XMLSyntaxError):
        return
