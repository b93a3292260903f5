"""An XML tag that knows its file and line, and rejects all content that was not requested."""

from __future__ import annotations

import difflib
import re
from collections.abc import Collection, Iterator
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import numpy as np
from lxml import etree

from limbcli.errors import CaseError
from limbcli.feb.notes import ReadingNotes
from limbcli.files.unpacking import DAMAGED, UnpackingBudget
from limbcli.files.xml import mixed_text, parsed_xml
from limbcli.model import Array, IntArray
from limbcli.numbers.math_expressions import VARIABLES, Formula, FormulaError, split_outside_brackets

UNITS = "mm-N-s"
VERSION, OLDER_VERSIONS = "4.0", ("3.0", "2.5")  # format of model files, and those converted to it
LARGEST_ID = 50_000_000  # largest accepted id of a node or an element
# The sections of a model file (FEBio 4.11, FEBioImport::BuildFileSectionMap)
SECTIONS = frozenset(
    [
        "Module", "Globals", "Output", "Control", "Material", "Mesh", "MeshDomains", "Include", "Initial",
        "Boundary", "Loads", "Contact", "Discrete", "Constraints", "Code", "MeshData", "LoadData", "Rigid",
        "Step", "MeshAdaptor", "Geometry",
    ]
)  # fmt: skip
_GZIP_MAGIC = b"\x1f\x8b"
_LARGEST = 500_000_000  # largest accepted size of a model's text (bytes)
_PLAIN_NAME = re.compile(r"\w[\w .+()-]{0,119}", re.ASCII)
_TAKEN = {"model.log", "force-depth.csv"}
_TAKEN_ENDINGS = (".feb", ".gz", ".json", ".jsonl", ".png", ".npz", ".xplt", ".dmp", ".vtu", ".pvd")
_LED = "self::logfile or self::plotfile"  # their file names are taken out before a run (`runnable`)
_MOST_IDS = 100_000_000  # largest accepted number of ids in one list
_CHANGE_A_VALUE = ("lc", "type")  # attributes that make a value differ from the text of its tag


@dataclass(frozen=True, eq=False)
class Tag:
    """One element of a model file. All reading methods raise CaseError with tag, line and file.

    notes : where refusals are collected, if the caller wants to judge the whole file; else they are raised
    """

    element: etree._Element
    file: Path
    notes: ReadingNotes | None = None

    @property
    def name(self) -> str:
        return str(self.element.tag)

    @property
    def line(self) -> int:
        return cast(int, self.element.sourceline or 0)

    @property
    def attributes(self) -> tuple[str, ...]:
        return tuple(str(key) for key, _ in self.element.items())

    @property
    def text(self) -> str:
        return (self.element.text or "").strip()

    def problem(self, what: str, *, fix: str, follows: bool = False) -> CaseError:
        """The error to raise for this tag; follows : what it misses may itself have been refused."""
        more = {"follows": True} if follows else {}
        return CaseError(
            f"<{self.name}>: {what}", where=f"{self.file}, line {self.line}", fix=fix, tag=self.name,
            line=self.line, file=str(self.file), **more,
        )  # fmt: skip

    def missing(self, what: str, fix: str = "add it, or correct the name") -> CaseError:
        """The error to raise where what this tag names is nowhere; that may itself have been refused."""
        return self.problem(f"there is no {what}", fix=fix, follows=True)

    def goes_on(self) -> AbstractContextManager[None]:
        """Collects what is refused within, or lets it through if nothing is collected."""
        return self.notes.goes_on() if self.notes is not None else nullcontext()

    def ignore(self, what: str) -> None:
        """Note that a part of the file, which cannot change a result, is left out."""
        if self.notes is not None:
            self.notes.ignore(what)

    @property
    def is_empty(self) -> bool:
        return not self.text and not len(self.element)

    # ------------------------------------------------------------ what may be there

    def allow(
        self, *, attributes: Collection[str] = (), children: Collection[str] = (), many: Collection[str] = ()
    ) -> None:
        """Reject attributes and children that are not listed; only those in `many` may be repeated."""
        for key in self.attributes:
            with self.goes_on():
                if key not in attributes:
                    raise self.problem(
                        f"limbcli does not know the attribute {key}={self.element.get(key)!r} here",
                        fix=_suggestion(key, attributes, "attribute"),
                    )
        seen = set()
        for child in self:
            with self.goes_on():
                if child.name not in children and child.name not in many:
                    known = [] if child.name in SECTIONS else [*children, *many]
                    raise child.problem(
                        f"limbcli does not know this tag inside <{self.name}>",
                        fix=_suggestion(child.name, known, "tag"),
                    )
                if child.name in seen and child.name not in many:
                    raise child.problem(f"it is given twice inside <{self.name}>", fix="keep one of them")
            seen.add(child.name)

    def __iter__(self) -> Iterator[Tag]:
        return (self.of(each) for each in self.element if isinstance(each.tag, str))

    def child(self, name: str) -> Tag | None:
        found = self.element.find(name)
        return None if found is None else self.of(found)

    def section(self, name: str) -> Tag:
        """The child, or an empty tag if there is none."""
        return self.child(name) or self.of(etree.Element(name))

    def of(self, element: etree._Element) -> Tag:
        """Another element of the same file."""
        return Tag(element, self.file, self.notes)

    def need(self, name: str) -> Tag:
        found = self.child(name)
        if found is None:
            raise self.problem(f"<{name}> is missing inside it", fix=f"add <{name}>")
        return found

    def all(self, name: str) -> list[Tag]:
        return [self.of(each) for each in self.element.iterfind(name)]

    # ------------------------------------------------------------ values

    def attribute(self, name: str) -> str:
        value = self.element.get(name)
        if value is None:
            raise self.problem(f"the attribute {name} is missing", fix=f'add {name}="..."')
        return str(value)

    def optional(self, name: str) -> str | None:
        value = self.element.get(name)
        return None if value is None else str(value)

    def id_of(self, key: str = "id") -> int:
        """An id, from 1 to `LARGEST_ID`."""
        text = self.attribute(key).strip()
        value = int(text) if text.isascii() and text.isdigit() and len(text) < 20 else 0
        if not 1 <= value <= LARGEST_ID:
            raise self.problem(
                f"{key}={text[:40]!r} is not an id",
                fix=f"number from 1, without large gaps (to {LARGEST_ID})",
            )
        return value

    def constant(self, *, attributes: Collection[str] = ()) -> str:
        """Text of a value; rejected if a load curve or a type other than "const" changes the value.

        attributes : those of these two that the caller reads itself
        """
        for key in _CHANGE_A_VALUE:
            given = self.optional(key)
            if given is not None and key not in attributes and (key, given) != ("type", "const"):
                raise self.problem(
                    f"limbcli does not accept the attribute {key}={given!r} here",
                    fix="give a plain value, or run the file with FEBio (--solver febio)",
                )
        return self.text

    def choice(self, values: Collection[str]) -> str:
        """The text, which must be one of `values` (case-insensitive)."""
        self.constant()
        for value in values:
            if self.text.lower() == value.lower():
                return value
        raise self.problem(f"{self.text!r} is not supported", fix=f"use one of: {', '.join(values)}")

    def number(self, *, attributes: Collection[str] = ()) -> float:
        return self.numbers(1, attributes=attributes)[0]

    def numbers(self, count: int, *, attributes: Collection[str] = ()) -> tuple[float, ...]:
        """Finite numbers separated by commas; attributes : see `constant`."""
        words = self.constant(attributes=attributes).split(",")
        try:
            values = tuple(float(word) for word in words if "_" not in word)
        except ValueError:
            values = ()
        if len(values) != count or not np.isfinite(values).all():
            raise self.problem(
                f"{self.text!r} is not {count} number(s)", fix="give finite numbers between commas"
            )
        return values

    def amounts(self, count: int, *, attributes: Collection[str] = ()) -> tuple[float | Formula, ...]:
        """Numbers, or formulas if the type is "math", separated by commas; attributes : see `constant`."""
        if self.optional("type") != "math":
            return self.numbers(count, attributes=attributes)
        parts = split_outside_brackets(self.text)
        if len(parts) != count:
            raise self.problem(f"{self.text!r} is not {count} formula(s)", fix="give formulas between commas")
        return tuple(self.formula(part) for part in parts)

    def formula(self, text: str, variables: Collection[str] = VARIABLES) -> Formula:
        """A formula of these variables."""
        try:
            found = Formula(text)
            if unknown := found.names - set(variables):
                raise FormulaError(f"{min(unknown)} has no value here")
        except FormulaError as error:
            raise self.problem(
                f"the formula {text[:60]!r} cannot be read: {error}",
                fix="correct it, or run the file with FEBio (--solver febio)",
            ) from error
        return found

    def integer(self) -> int:
        value = self.number()
        if value != int(value):
            raise self.problem(f"{self.text!r} is not a whole number", fix="give a whole number")
        return int(value)

    def flag(self) -> bool:
        return bool(self.integer())

    def ids(self) -> IntArray:
        """Whole numbers separated by commas; a:b and a:b:step are ranges as in FEBio.

        If numbers are separated only by white space, FEBio takes the first (XMLTag::value).
        """
        values: list[int] = []
        words = [word for each in self.text.split(",") if (word := each.strip())]
        try:
            if "_" in self.text:
                raise ValueError("a Python number")
            if ":" not in self.text:
                return np.array(words, dtype=np.int64)
            for word in words:
                first, *rest = (int(part) for part in word.split(":")[:3])
                several = range(first, rest[0] + 1, *rest[1:]) if rest else [first]
                if len(values) + len(several) > _MOST_IDS:
                    raise ValueError("too many")
                values.extend(several)
            return np.array(values, dtype=np.int64)
        except (ValueError, OverflowError) as error:
            raise self.problem(
                "this is not a list of ids", fix="give whole numbers between commas"
            ) from error

    def table(self, names: Collection[str], width: int, key: str) -> tuple[IntArray, Array]:
        """Ids (attribute `key`) and `width` numbers of each child, parsed in bulk for speed: (n,), (n,
        width)."""
        rows = [each for each in self.element if isinstance(each.tag, str)]
        for each in rows:
            if each.tag not in names or list(each.attrib) != [key]:
                Tag(self.element, self.file).allow(attributes=self.attributes, many=names)
                Tag(each, self.file).allow(attributes=(key,))
                Tag(each, self.file).attribute(key)
        try:
            ids = np.array([each.get(key) for each in rows], dtype=np.int64)
            text = ",".join(each.text or "" for each in rows)
            values = np.array(text.split(","), dtype=np.float64) if rows else np.zeros(0)
            if "_" not in text and np.isfinite(values).all():
                return ids, values.reshape(len(rows), width)
        except (ValueError, OverflowError):
            pass
        for each in rows:
            tag = Tag(each, self.file)
            tag.numbers(width)
            tag.id_of(key)
        raise self.problem("its rows cannot be read", fix=f"give {width} number(s) in every row")


def _suggestion(name: str, known: Collection[str], kind: str) -> str:
    near = difflib.get_close_matches(name, list(known), n=1)
    if near:
        return f"did you mean {near[0]}? Otherwise remove this {kind}, or run the file with FEBio"
    listed = f"known here: {', '.join(known)}; " if known else ""
    return f"{listed}remove this {kind}, or run the file with FEBio (--solver febio)"


def open_model(path: Path, notes: ReadingNotes | None = None) -> Tag:
    """The root tag of a `.feb` or `.feb.gz` file, of format 4.0, or of an older one that can be converted.

    Raises CaseError if the file is absent, is not XML, or is not a FEBio model of format 2.5, 3.0 or 4.0.
    """
    if not path.is_file():
        raise CaseError(f"the model file {path} does not exist", where=str(path), fix="check the path")
    try:
        root = parsed_xml(model_text(path), remove_pis=True)
    except DAMAGED as error:
        raise CaseError(
            f"this is not a readable XML file ({error})", where=str(path), fix="write or copy the file again"
        ) from error
    if root.tag != "febio_spec":
        raise CaseError("this is not a FEBio model file", where=str(path), fix="give a .feb file")
    tag = Tag(root, path, notes)
    # Comments inside the sections are removed, joining the text before and after, as FEBio does
    # (XMLReader::GetChar); those between the sections are kept, among them the writer's own.
    for section in root:
        if isinstance(section.tag, str):
            etree.strip_elements(section, etree.Comment, with_tail=False)
    if (mixed := mixed_text(root)) is not None:
        raise tag.of(mixed[0]).problem(
            f"it contains the text {mixed[1][:40]!r} beside other tags, where nothing reads it",
            fix="remove this text, or put it into the tag that it belongs to",
        )
    version = tag.optional("version") or ""
    if version not in (VERSION, *OLDER_VERSIONS):
        raise tag.problem(
            f"format version {version!r} is not supported",
            fix="save the model in FEBio's format 4.0 (FEBio Studio: export)",
        )
    # no references to other files: a run uses a single file, and its hash identifies the whole model
    steps = tag.child("Step")
    for each in (*tag, *(part for step in steps or () for part in step)):
        if each.name == "Include" or each.optional("from") is not None:
            raise each.problem(
                f"it is in another file ({each.optional('from') or each.text})",
                fix="put its content in this place, in one file",
            )
    _check_file_names(tag)
    return tag


def stated_units(root: Tag) -> str:
    """The unit system that a file states; "" if it states none."""
    return (root.element.findtext("Module/units") or "").strip()


def units_of(root: Tag) -> str:
    """The unit system that a file states; `UNITS` if it states none."""
    return stated_units(root) or UNITS


def is_native(root: Tag) -> bool:
    """Whether FEBio's records of the file itself are in our units and numbers: format 4.0 in mm-N-s."""
    return root.optional("version") == VERSION and units_of(root) == UNITS


def drop_empty(owner: Tag, known: Collection[str]) -> None:
    """Take out empty sections that are not known, which FEBio skips."""
    for child in list(owner):
        if child.is_empty and child.name not in known and child.name in SECTIONS:
            owner.ignore(f"empty <{child.name}>")
            owner.element.remove(child.element)


def model_text(path: Path) -> bytes:
    """Uncompressed content of a `.feb` or `.feb.gz` file.

    Raises OSError, EOFError, zlib.error if it cannot be read, or exceeds the largest accepted size of a
    model.
    """
    if path.stat().st_size > _LARGEST:
        raise OSError(f"it is larger than {_LARGEST / 1e6:.0f} MB")
    content = path.read_bytes()
    return UnpackingBudget(_LARGEST).gunzip(content) if content.startswith(_GZIP_MAGIC) else content


def _check_file_names(root: Tag) -> None:
    """Check that the files written by a solver stay in the run's folder and do not overwrite each other or
    its own files.

    Raises CaseError if a name contains a folder, is one that the run itself needs, or occurs twice.
    """
    seen: set[str] = set()
    for element in cast(list[etree._Element], root.element.xpath(f".//*[@file][not({_LED})]")):
        tag = Tag(element, root.file)
        name = tag.attribute("file")
        fix = 'give a plain file name of its own, such as file="nodes.csv"'
        if not _PLAIN_NAME.fullmatch(name):
            raise tag.problem(
                f"file={name!r} is not a plain file name; it could be written anywhere", fix=fix
            )
        low = name.lower()
        if low in _TAKEN or low.endswith(_TAKEN_ENDINGS):
            raise tag.problem(f"file={name!r} is a name that the run itself needs", fix=fix)
        if low in seen:
            raise tag.problem(f"file={name!r} is written twice", fix=fix)
        seen.add(low)
