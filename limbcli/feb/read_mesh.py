"""`<Mesh>`, `<MeshDomains>` and `<MeshData>`."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from limbcli.feb.xml import LARGEST_ID, Tag
from limbcli.model import NODES_PER_CELL, Array, Block, ElementMap, IntArray, Mesh, NodeMap, Surface

# Element types that name their integration rule too, as FEBio takes them (FEModelBuilder::ElementSpec); the
# rules of the second group are those of the plain types.
TYPES_WITH_RULE = {
    "TET10G4": "tet10",
    "TET10G8": "tet10", "TET10G8_S7": "tet10", "HEX8G8": "hex8",
    "QUAD4G8": "quad4", "TRI3G6": "tri3", "tri3s": "tri3", "q4s": "quad4", "q4ans": "quad4", "q4eas": "quad4",
}  # fmt: skip
DEFAULT_RULES = (None, "TET10G8", "TET10G8_S7", "HEX8G8", "PENTA6G6")
_SECTIONS = (
    "Nodes", "Elements", "NodeSet", "Surface", "SurfacePair", "ElementSet", "Edge", "PartList", "DiscreteSet",
)  # fmt: skip
ADD_TO_MESH = "add it to <Mesh>, or correct the name"
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
            raise tag.missing(f"{kind} {missing}", f"name only {kind}s that the <Mesh> defines")
        return numbers


@dataclass(frozen=True, eq=False)
class MeshSection:
    """The mesh and its named parts, to which other sections refer.

    element_sets : cells by name; of part lists, "@part_list:NAME"
    edges : nodes of <Edge> sections; unlisted : nodes of the named <Nodes> sections
    rules : integration rule by block, of sections whose type names one
    """

    mesh: Mesh
    numbering: Numbering
    pairs: Mapping[str, tuple[str, str]]
    element_sets: Mapping[str, IntArray] = field(default_factory=dict)
    edges: Mapping[str, IntArray] = field(default_factory=dict)
    unlisted: Mapping[str, IntArray] = field(default_factory=dict)
    rules: Mapping[str, str] = field(default_factory=dict)

    def node_set(self, tag: Tag, name: str) -> str:
        """The node set of this name; one that FEBio makes of something else is added to the mesh."""
        sets = self.mesh.node_sets
        if name in sets:
            return name
        kind, _, source = name.rpartition(":") if name.startswith("@") else ("", "", name)
        nodes = self._nodes_of(tag, kind, source)
        if nodes is None:
            raise tag.missing(f"node set {name!r}", ADD_TO_MESH)
        if kind != "@part_list" and source in sets:
            return source
        made = source if kind != "@part_list" else f"nodes of {source}"
        while made in sets and not np.array_equal(sets[made], nodes):
            made = f"{made} again"
        assert isinstance(sets, dict)
        sets.setdefault(made, nodes)
        return made

    def _nodes_of(self, tag: Tag, kind: str, name: str) -> IntArray | None:
        """Nodes of what a reference with @ names, in the order of first appearance; of a <Nodes> section.

        Source: FEBio 4.11, FEModelBuilder::FindNodeSet. A node set of the same name goes first there.
        """
        if kind == "@surface" and name in self.mesh.surfaces:
            return _each_once(self.mesh.surfaces[name].facets.values())
        if kind == "@edge" and name in self.edges:
            return _each_once([self.edges[name]])
        if kind == "@elem_set":
            return self._nodes_of_cells(self.element_set(tag, name))
        if kind == "@part_list":
            return self._nodes_of_cells(self.element_set(tag, f"{kind}:{name}"))
        return self.unlisted.get(name) if not kind else None

    def _nodes_of_cells(self, cells: IntArray) -> IntArray:
        rows: list[IntArray] = []
        ends = np.cumsum([len(block.cells) for block in self.mesh.blocks])
        for cell in cells.tolist():
            k = int(np.searchsorted(ends, cell, side="right"))
            block = self.mesh.blocks[k]
            rows.append(block.cells[cell - int(ends[k]) + len(block.cells)])
        return _each_once(rows)

    def element_set(self, tag: Tag, name: str) -> IntArray:
        """Cells of an element set or a whole part, numbered over all blocks."""
        if name in self.element_sets:
            return self.element_sets[name]
        start = 0
        for block in self.mesh.blocks:
            if block.name == name:
                return start + np.arange(len(block.cells))
            start += len(block.cells)
        raise tag.missing(f"element set {name!r}", ADD_TO_MESH)

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
            follows=True,
        )


def _each_once(rows: Iterable[IntArray]) -> IntArray:
    nodes = np.concatenate([np.asarray(each).ravel() for each in rows] or [np.zeros(0, dtype=np.int64)])
    _, first = np.unique(nodes, return_index=True)
    return np.asarray(nodes[np.sort(first)])


def read_mesh(tag: Tag) -> MeshSection:
    tag.allow(many=_SECTIONS)
    for kinds in _NAMES:
        refuse_repeated([each for each in tag if each.name in kinds])
    node_ids, points, unlisted = _nodes(tag)
    node_table = Numbering.of(node_ids)
    blocks, cell_ids, rules = _blocks(tag, node_table)
    numbering = Numbering(node_table, Numbering.of(cell_ids))
    surfaces = _surfaces(tag, node_table)
    mesh = Mesh(points, blocks, _node_sets(tag, node_table), surfaces, _own_ids(node_ids), _own_ids(cell_ids))
    edges: dict[str, IntArray] = {}
    section = MeshSection(mesh, numbering, _pairs(tag, surfaces), {}, edges, unlisted, rules)
    for each in tag.all("Edge"):
        each.allow(attributes=("name",), many=("line2", "line3"))
        with each.goes_on():
            rows = [Numbering.look_up(node_table, line.ids(), line, "node") for line in each]
            edges[each.attribute("name")] = np.concatenate(rows or [np.zeros(0, dtype=np.int64)])
    sets: dict[str, IntArray] = {}
    for each in tag.all("ElementSet"):
        each.allow(attributes=("name",))
        with each.goes_on():
            sets[each.attribute("name")] = Numbering.look_up(numbering.cells, each.ids(), each, "element")
    for each in tag.all("PartList"):
        each.allow(attributes=("name",))
        with each.goes_on():
            parts = [section.element_set(each, name.strip()) for name in each.text.split(",")]
            sets[f"@part_list:{each.attribute('name')}"] = np.concatenate(parts)
    if tag.child("DiscreteSet") is not None:
        tag.ignore("<DiscreteSet>, which only <Discrete> uses")
    return replace(section, element_sets=sets)


def _own_ids(ids: IntArray) -> IntArray | None:
    """Ids that do not simply count from 1."""
    return None if np.array_equal(ids, np.arange(1, len(ids) + 1)) else ids


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


def _nodes(tag: Tag) -> tuple[IntArray, Array, dict[str, IntArray]]:
    """Ids, points, and the nodes (from 0) of each named section."""
    tables, named, start = [], {}, 0
    for each in tag.all("Nodes"):
        each.allow(attributes=("name",), many=("node",))
        tables.append(each.table(("node",), 3, "id"))
        _check_ids(tables[-1][0], each)
        named[each.optional("name") or ""] = start + np.arange(len(tables[-1][0]))
        start += len(tables[-1][0])
    if not tables:
        raise tag.problem("<Nodes> is missing inside it", fix="add <Nodes>")
    ids = np.concatenate([table[0] for table in tables])
    if len(np.unique(ids)) != len(ids) or ids.min(initial=1) < 1:
        raise tag.problem("node ids are repeated or below 1", fix="number the nodes from 1")
    named.pop("", None)
    return ids, np.concatenate([table[1] for table in tables]), named


def _blocks(tag: Tag, node_table: IntArray) -> tuple[tuple[Block, ...], IntArray, dict[str, str]]:
    """Blocks, ids of their cells, and the integration rules that types name, by block.

    Such a type also sets the rule of all later sections of this shape (FEBio, FEModelBuilder::ElementSpec).
    """
    blocks, ids, rules = [], [], {}
    rule_of_kind: dict[str, str] = {}
    for each in tag.all("Elements"):
        with each.goes_on():
            each.allow(attributes=("type", "name"), many=("elem",))
            named = each.attribute("type")
            kind = TYPES_WITH_RULE.get(named, named)
            if kind not in NODES_PER_CELL:
                raise each.problem(
                    f"element type {named!r} is not supported", fix=f"use one of {list(NODES_PER_CELL)}"
                )
            if kind != named:
                rule_of_kind[kind] = named
            cell_ids, cells = each.table(("elem",), NODES_PER_CELL[kind], "id")
            _check_ids(cell_ids, each)
            numbers = Numbering.look_up(node_table, _whole(cells, each), each, "node")
            blocks.append(Block(each.attribute("name"), kind, numbers))  # type: ignore[arg-type]
            ids.append(cell_ids)
            if kind in rule_of_kind:
                rules[each.attribute("name")] = rule_of_kind[kind]
    names = [block.name for block in blocks]
    if len(set(names)) != len(names):
        raise tag.problem(
            f"two <Elements> sections share a name: {names}", fix="name every section differently"
        )
    all_ids = np.concatenate(ids) if ids else np.zeros(0, dtype=np.int64)
    if len(np.unique(all_ids)) != len(all_ids):
        raise tag.problem("element ids are repeated", fix="number the elements through all sections")
    return tuple(blocks), all_ids, rules


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
            if facet.tag in _FACETS:  # others have been refused
                if list(facet.attrib) != ["id"]:
                    Tag(facet, each.file).allow(attributes=("id",))
                rows.setdefault(facet.tag, []).append(facet.text or "")
        facets = {}
        for kind, texts in rows.items():
            try:
                ids = np.array(",".join(texts).split(","), dtype=np.int64)
                cells = ids.reshape(len(texts), NODES_PER_CELL[kind])
            except (ValueError, OverflowError) as error:
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
        with each.goes_on():
            for name in names:
                if name not in surfaces:
                    raise each.missing(f"surface {name!r}", ADD_TO_MESH)
            pairs[each.attribute("name")] = names
    return pairs


# ---------------------------------------------------------------- MeshData


def read_mesh_data(
    tag: Tag, section: MeshSection
) -> tuple[dict[str, ElementMap], dict[str, NodeMap], dict[str, Array]]:
    """The maps of elements and of nodes by name, and mean shell thicknesses by block; `lid` counts from 1."""
    elements: dict[str, ElementMap] = {}
    nodes: dict[str, NodeMap] = {}
    thicknesses: dict[str, Array] = {}
    tag.allow(many=("ElementData", "NodeData", "SurfaceData"))
    refuse_repeated(tag)
    for each in tag:
        with each.goes_on():
            if each.name == "ElementData" and each.optional("type") == "shell thickness":
                block, thickness = _thickness(each, section)
                thicknesses[block] = thickness
            elif each.name == "ElementData":
                found = _element_map(each, section)
                elements[found.name] = found
            elif each.name == "NodeData":
                node_map = _node_map(each, section)
                nodes[node_map.name] = node_map
            elif each.name == "SurfaceData":
                tag.ignore(f"surface map {each.optional('name')!r}, which only <Loads> use")
    return elements, nodes, thicknesses


def _element_map(tag: Tag, section: MeshSection) -> ElementMap:
    kind = tag.optional("type")
    if kind not in (None, "const"):
        raise tag.problem(
            f"a map of type {kind!r} is not supported", fix="give one value for each element, without type"
        )
    attributes = ("name", "elem_set", "data_type", "type")
    tag.allow(attributes=(*attributes, "format"), many=("e",) if kind is None else ("value",))
    if (tag.optional("format") or "ITEM") != "ITEM":
        raise tag.problem(f"format={tag.optional('format')!r} is not supported", fix="give one value each")
    width = _width(tag)
    block = section.block_of(tag, tag.attribute("elem_set"))
    count = len(section.mesh.block(block).cells)
    if kind == "const":
        values = np.tile(tag.need("value").numbers(width), (count, 1))
    else:
        values = _by_lid(tag, "e", width, count)
    return ElementMap(tag.attribute("name"), block, values if width > 1 else values[:, 0])


def _node_map(tag: Tag, section: MeshSection) -> NodeMap:
    if tag.optional("type") is not None:
        raise tag.problem(
            f"a map of type {tag.optional('type')!r} is not supported",
            fix="give one value for each node, without type",
        )
    tag.allow(attributes=("name", "node_set", "data_type"), many=("node",))
    if _width(tag) != 1:
        raise tag.problem("only scalar node maps are supported", fix="give one scalar map per component")
    node_set = section.node_set(tag, tag.attribute("node_set"))
    values = _by_lid(tag, "node", 1, len(section.mesh.node_sets[node_set]))
    return NodeMap(tag.attribute("name"), node_set, values[:, 0])


def _thickness(tag: Tag, section: MeshSection) -> tuple[str, Array]:
    """Mean thickness (n_cells,) of the shells of a block; a row gives one value, or one for each node."""
    tag.allow(attributes=("name", "elem_set", "type"), many=("e",))
    block = section.block_of(tag, tag.attribute("elem_set"))
    found = np.zeros(len(section.mesh.block(block).cells))
    for row in tag:
        lid = row.id_of("lid")
        if lid > len(found):
            raise row.problem(f"lid {lid} is beyond the {len(found)} elements", fix="correct it")
        found[lid - 1] = np.mean(row.numbers(row.text.count(",") + 1))
    return block, found


def _width(tag: Tag) -> int:
    """Number of values per row."""
    widths = {"scalar": 1, "vec3": 3}
    data_type = tag.optional("data_type") or "scalar"
    if data_type not in widths:
        raise tag.problem(f"data_type {data_type!r} is not supported", fix="use scalar or vec3")
    return widths[data_type]


def _by_lid(tag: Tag, row: str, width: int, count: int) -> Array:
    lids, values = tag.table((row,), width, "lid")
    if not np.array_equal(np.sort(lids), np.arange(1, count + 1)):
        raise tag.problem(
            f"it has {len(lids)} values for {count} items", fix=f"give every lid from 1 to {count} once"
        )
    ordered = np.empty_like(values)
    ordered[lids - 1] = values
    return ordered
