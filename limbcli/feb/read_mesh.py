"""`<Mesh>`, `<MeshDomains>` and `<MeshData>`."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np

from limbcli.feb.xml import LARGEST_ID, Tag
from limbcli.model import NODES_PER_CELL, Array, Block, ElementMap, IntArray, Mesh, NodeMap, Surface

_FACETS = ("tri3", "tri6", "quad4")
_NAMES = (
    ("Nodes", "NodeSet"),
    ("Elements", "ElementSet"),
    ("Surface",),
    ("SurfacePair",),
)  # one name, one set


@dataclass(frozen=True, eq=False)
class Numbering:
    """Conversion of the file's ids to numbers from 0; `cells` count over all blocks in order."""

    nodes: IntArray
    cells: IntArray

    @staticmethod
    def of(ids: IntArray) -> IntArray:
        """Table with table[id] = number, -1 for unused ids; ids from 1 to `LARGEST_ID`."""
        table = np.full(int(ids.max(initial=0)) + 1, -1, dtype=np.int64)
        table[ids] = np.arange(len(ids))
        return table

    @staticmethod
    def look_up(table: IntArray, ids: IntArray, tag: Tag, kind: str) -> IntArray:
        inside = (ids >= 0) & (ids < len(table))
        numbers = np.where(inside, table[np.where(inside, ids, 0)], -1)
        if (numbers < 0).any():
            at = int(np.argmax(numbers.ravel() < 0))
            missing = int(ids.ravel()[at])
            tag = _row(tag, at // ids.shape[1]) if ids.ndim == 2 and len(list(tag)) == len(ids) else tag
            raise tag.problem(
                f"there is no {kind} {missing}", fix=f"name only {kind}s that the <Mesh> defines"
            )
        return numbers


@dataclass(frozen=True, eq=False)
class MeshSection:
    """The mesh and its named parts, to which other sections refer."""

    mesh: Mesh
    numbering: Numbering
    pairs: Mapping[str, tuple[str, str]]
    element_sets: Mapping[str, IntArray] = field(default_factory=dict)

    def node_set(self, tag: Tag, name: str) -> str:
        if name not in self.mesh.node_sets:
            raise tag.problem(f"there is no node set {name!r}", fix="add it to <Mesh>, or correct the name")
        return name

    def element_set(self, tag: Tag, name: str) -> IntArray:
        """Cells of an element set or a whole part, numbered over all blocks."""
        if name in self.element_sets:
            return self.element_sets[name]
        start = 0
        for block in self.mesh.blocks:
            if block.name == name:
                return start + np.arange(len(block.cells))
            start += len(block.cells)
        raise tag.problem(f"there is no element set {name!r}", fix="add it to <Mesh>, or correct the name")

    def block_of(self, tag: Tag, elem_set: str) -> str:
        """The block whose cells the element set lists completely and in order."""
        start = 0
        for block in self.mesh.blocks:
            covered = np.arange(start, start + len(block.cells))
            start += len(block.cells)
            listed = self.element_sets.get(elem_set, np.zeros(0, dtype=np.int64))
            if block.name == elem_set or np.array_equal(listed, covered):
                return block.name
        raise tag.problem(
            f"the element set {elem_set!r} is not a whole <Elements> section",
            fix="define the map over a whole part",
        )


def read_mesh(tag: Tag) -> MeshSection:
    tag.allow(many=("Nodes", "Elements", "NodeSet", "Surface", "SurfacePair", "ElementSet"))
    for kinds in _NAMES:
        refuse_repeated([each for each in tag if each.name in kinds])
    node_ids, points = _nodes(tag)
    node_table = Numbering.of(node_ids)
    blocks, cell_ids = _blocks(tag, node_table)
    numbering = Numbering(node_table, Numbering.of(cell_ids))
    surfaces = _surfaces(tag, node_table)
    mesh = Mesh(points=points, blocks=blocks, node_sets=_node_sets(tag, node_table), surfaces=surfaces)
    sets = {}
    for each in tag.all("ElementSet"):
        each.allow(attributes=("name",))
        sets[each.attribute("name")] = Numbering.look_up(numbering.cells, each.ids(), each, "element")
    return MeshSection(mesh, numbering, _pairs(tag, surfaces), sets)


def refuse_repeated(tags: Iterable[Tag]) -> None:
    """Reject repeated names: FEBio either refuses them or takes the first."""
    seen: dict[str, Tag] = {}
    for each in tags:
        name = each.optional("name")
        first = seen.setdefault(name, each) if name is not None else each
        if first is not each:
            raise each.problem(
                f"the name {name!r} is that of the <{first.name}> in line {first.line}",
                fix="name them differently",
            )


def _nodes(tag: Tag) -> tuple[IntArray, Array]:
    tables = []
    for each in tag.all("Nodes"):
        each.allow(attributes=("name",), many=("node",))
        tables.append(each.table(("node",), 3, "id"))
        _check_ids(tables[-1][0], each)
    if not tables:
        raise tag.problem("<Nodes> is missing inside it", fix="add <Nodes>")
    ids = np.concatenate([table[0] for table in tables])
    if len(np.unique(ids)) != len(ids) or ids.min(initial=1) < 1:
        raise tag.problem("node ids are repeated or below 1", fix="number the nodes from 1")
    return ids, np.concatenate([table[1] for table in tables])


def _blocks(tag: Tag, node_table: IntArray) -> tuple[tuple[Block, ...], IntArray]:
    blocks, ids = [], []
    for each in tag.all("Elements"):
        each.allow(attributes=("type", "name"), many=("elem",))
        kind = each.attribute("type")
        if kind not in NODES_PER_CELL:
            raise each.problem(
                f"element type {kind!r} is not supported", fix=f"use one of {list(NODES_PER_CELL)}"
            )
        cell_ids, cells = each.table(("elem",), NODES_PER_CELL[kind], "id")
        _check_ids(cell_ids, each)
        numbers = Numbering.look_up(node_table, _whole(cells, each), each, "node")
        blocks.append(Block(each.attribute("name"), kind, numbers))  # type: ignore[arg-type]
        ids.append(cell_ids)
    names = [block.name for block in blocks]
    if len(set(names)) != len(names):
        raise tag.problem(
            f"two <Elements> sections share a name: {names}", fix="name every section differently"
        )
    all_ids = np.concatenate(ids) if ids else np.zeros(0, dtype=np.int64)
    if len(np.unique(all_ids)) != len(all_ids):
        raise tag.problem("element ids are repeated", fix="number the elements through all sections")
    return tuple(blocks), all_ids


def _check_ids(ids: IntArray, tag: Tag) -> None:
    """Check the ids of a section's rows, because a table up to the largest id is allocated."""
    wrong = (ids < 1) | (ids > LARGEST_ID)
    if wrong.any():
        _row(tag, int(np.argmax(wrong))).id_of()


def _whole(cells: Array, tag: Tag) -> IntArray:
    """Node ids of elements, which must be whole numbers (others would be truncated)."""
    ids = np.clip(np.rint(cells), -1, LARGEST_ID + 1).astype(np.int64)
    if not np.array_equal(ids, cells):
        row = int(np.argmax((ids != cells).any(axis=1)))
        raise _row(tag, row).problem("a node id is not a whole number in range", fix="name nodes of <Nodes>")
    return ids


def _row(tag: Tag, number: int) -> Tag:
    """The child tag with this number."""
    return next(itertools.islice(tag, number, None))


def _node_sets(tag: Tag, node_table: IntArray) -> dict[str, IntArray]:
    sets = {}
    for each in tag.all("NodeSet"):
        each.allow(attributes=("name",))
        sets[each.attribute("name")] = Numbering.look_up(node_table, each.ids(), each, "node")
    return sets


def _surfaces(tag: Tag, node_table: IntArray) -> dict[str, Surface]:
    surfaces = {}
    for each in tag.all("Surface"):
        each.allow(attributes=("name",), many=_FACETS)
        rows: dict[str, list[str]] = {}
        for facet in each.element:
            if isinstance(facet.tag, str):
                if list(facet.attrib) != ["id"]:
                    Tag(facet, each.file).allow(attributes=("id",))
                rows.setdefault(facet.tag, []).append(facet.text or "")
        facets = {}
        for kind, texts in rows.items():
            try:
                ids = np.array(",".join(texts).split(","), dtype=np.int64)
                cells = ids.reshape(len(texts), NODES_PER_CELL[kind])
            except ValueError as error:
                raise each.problem(
                    f"its {kind} rows cannot be read", fix="give node ids between commas"
                ) from error
            facets[kind] = Numbering.look_up(node_table, cells, each, "node")
        name = each.attribute("name")
        surfaces[name] = Surface(name, facets)
    return surfaces


def _pairs(tag: Tag, surfaces: Mapping[str, Surface]) -> dict[str, tuple[str, str]]:
    pairs = {}
    for each in tag.all("SurfacePair"):
        each.allow(attributes=("name",), children=("primary", "secondary"))
        names = each.need("primary").text, each.need("secondary").text
        for name in names:
            if name not in surfaces:
                raise each.problem(
                    f"there is no surface {name!r}", fix="add it to <Mesh>, or correct the name"
                )
        pairs[each.attribute("name")] = names
    return pairs


# ---------------------------------------------------------------- MeshData


def read_mesh_data(tag: Tag | None, section: MeshSection) -> tuple[dict[str, ElementMap], dict[str, NodeMap]]:
    """The maps by name; `lid` counts from 1 within the set."""
    elements: dict[str, ElementMap] = {}
    nodes: dict[str, NodeMap] = {}
    if tag is None:
        return elements, nodes
    tag.allow(many=("ElementData", "NodeData"))
    refuse_repeated(tag)
    for each in tag.all("ElementData"):
        each.allow(attributes=("name", "elem_set", "data_type", "datatype"), many=("e",))
        width = _width(each)
        block = section.block_of(each, each.attribute("elem_set"))
        values = _by_lid(each, "e", width, len(section.mesh.block(block).cells))
        name = each.attribute("name")
        elements[name] = ElementMap(name, block, values if width > 1 else values[:, 0])
    for each in tag.all("NodeData"):
        each.allow(attributes=("name", "node_set", "data_type", "datatype"), many=("node",))
        if _width(each) != 1:
            raise each.problem("only scalar node maps are supported", fix="give one scalar map per component")
        node_set = section.node_set(each, each.attribute("node_set"))
        values = _by_lid(each, "node", 1, len(section.mesh.node_sets[node_set]))
        nodes[each.attribute("name")] = NodeMap(each.attribute("name"), node_set, values[:, 0])
    return elements, nodes


def _width(tag: Tag) -> int:
    """Number of values per row; FEBio 4 uses `data_type`, files of version 3 have `datatype`."""
    widths = {"scalar": 1, "vec3": 3}
    datatype = tag.optional("data_type") or tag.optional("datatype") or "scalar"
    if datatype not in widths:
        raise tag.problem(f"datatype {datatype!r} is not supported", fix="use scalar or vec3")
    return widths[datatype]


def _by_lid(tag: Tag, row: str, width: int, count: int) -> Array:
    lids, values = tag.table((row,), width, "lid")
    if not np.array_equal(np.sort(lids), np.arange(1, count + 1)):
        raise tag.problem(
            f"it has {len(lids)} values for {count} items", fix=f"give every lid from 1 to {count} once"
        )
    ordered = np.empty_like(values)
    ordered[lids - 1] = values
    return ordered
