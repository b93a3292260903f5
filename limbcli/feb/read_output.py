"""`<Output>`: the record files that the solver writes."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from limbcli.feb.read_mesh import MeshSection, Numbering
from limbcli.feb.xml import Tag
from limbcli.model import IntArray, LogRecord
from limbcli.model.bodies import RigidBody

_SET_OF = {"node_data": ("node_set",), "element_data": ("elem_set",)}
_RECORDS = ("rigid_body_data", "node_data", "element_data")
_OTHER_RECORDS = (
    "face_data", "surface_data", "domain_data", "model_data", "rigid_connector_data",
)  # fmt: skip
_DELIMITERS = (None, ",", " ", "\t")


def read_output(
    tag: Tag, mesh: MeshSection, bodies: Mapping[str, RigidBody], materials_by_id: Mapping[str, str]
) -> tuple[tuple[LogRecord, ...], tuple[str, ...]]:
    """(records of the log file, variables of the plot file)."""
    tag.allow(children=("logfile", "plotfile"))
    plotfile, logfile = tag.section("plotfile"), tag.section("logfile")
    plotfile.allow(attributes=("type", "file"), children=("compression",), many=("var",))
    variables = tuple(each.attribute("type") for each in plotfile.all("var"))
    if plotfile.optional("file") or plotfile.child("compression") is not None:
        tag.ignore("the form of <plotfile>, which a run does not keep")
    records: list[LogRecord] = []
    logfile.allow(attributes=("file",), many=(*_RECORDS, *_OTHER_RECORDS))
    if logfile.attributes:
        tag.ignore("the name of <logfile>, as that of a run is model.log")
    for each in logfile:
        with each.goes_on():
            if not is_read(each):
                tag.ignore(f"<{each.name}> {each.optional('data')!r}, which limbcli does not read")
                continue
            each.allow(attributes=("data", "delim", "file", "name", *_SET_OF.get(each.name, ())))
            check_form(each)
            records.append(_record(each, mesh, bodies, materials_by_id))
    return tuple(records), variables


def is_read(tag: Tag) -> bool:
    """Whether limbcli reads this output: a table of nodes, elements or a body, in a file of its own.

    FEBio writes the other tables too, or into its log; an expression (data="=...") has no name.
    """
    named = not any(name.strip().startswith("=") for name in (tag.optional("data") or "").split(";"))
    return tag.name in _RECORDS and tag.optional("file") is not None and named


def _record(
    tag: Tag, mesh: MeshSection, bodies: Mapping[str, RigidBody], materials_by_id: Mapping[str, str]
) -> LogRecord:
    fields = tuple(name.strip() for name in tag.attribute("data").split(";"))
    file = tag.attribute("file")
    if tag.name == "rigid_body_data":
        by_id = {number: name for number, name in materials_by_id.items() if name in bodies}
        return LogRecord("rigid_body", fields, file, logged_body(tag, by_id))
    if tag.name == "node_data":
        return LogRecord("node", fields, file, _nodes(tag, mesh))
    name = tag.optional("elem_set")  # of a named set or a whole part
    cells = listed_cells(tag, mesh.numbering.cells) if name is None else mesh.element_set(tag, name)
    return LogRecord("element", fields, file, cells)


def _nodes(tag: Tag, mesh: MeshSection) -> IntArray | None:
    """Nodes of the named set if there is one, else those listed; None: all."""
    name = tag.optional("node_set")
    if name is not None:
        return mesh.mesh.node_sets[mesh.node_set(tag, name)]
    return listed_nodes(tag, mesh.numbering.nodes)


def listed_nodes(tag: Tag, table: IntArray) -> IntArray | None:
    """Nodes (from 0) that a record lists by number; None: it lists none, hence all.

    FEBio takes these numbers as places in the file, from 1, and not as ids (NodeDataRecord::Evaluate); beyond
    the last node it prints zeros. A number that is the id of another node is therefore refused.
    """
    if not tag.text:
        return None
    ids = tag.ids()
    inside = (ids >= 0) & (ids < len(table))
    places = np.where(inside, table[np.where(inside, ids, 0)], -1) + 1
    if (places != ids).any():
        at = int(np.argmax(places != ids))
        is_it = f"node {ids[at]} is the {places[at]}. in the file" if places[at] else f"no node is {ids[at]}"
        raise tag.problem(
            f"FEBio takes these numbers as places of nodes in the file, not as their ids, and {is_it}",
            fix="list them in a <NodeSet> and name it, node_set=..., or number the nodes 1, 2, 3, ...",
        )
    return ids - 1


def listed_cells(tag: Tag, table: IntArray) -> IntArray | None:
    """Cells (from 0) that a record lists by their ids (ElementDataRecord::Evaluate); None: all."""
    return Numbering.look_up(table, tag.ids(), tag, "element") if tag.text else None


def check_form(tag: Tag) -> None:
    """Check that the record's file can be read back."""
    unreadable = {
        "delim": tag.optional("delim") not in _DELIMITERS,
        "format": tag.optional("format") is not None,
        "comments": tag.optional("comments") not in (None, "on"),
    }
    for name, wrong in unreadable.items():
        if wrong:
            raise tag.problem(
                f"{name}={tag.optional(name)!r} leaves a file that limbcli cannot read",
                fix='give delim="," and neither format nor comments',
            )


def logged_body(tag: Tag, bodies: Mapping[str, str]) -> str:
    """The rigid body of a record, by its material id in `bodies`; an empty list means all of them."""
    if not tag.text and len(bodies) == 1:
        return next(iter(bodies.values()))
    if tag.text not in bodies:
        raise tag.problem(
            f"{tag.text!r} is not the material id of one rigid body",
            fix="write one record for each body, by its id",
        )
    return bodies[tag.text]
