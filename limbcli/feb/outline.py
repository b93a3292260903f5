"""Outline of a model file: what is needed to run it with FEBio and to read its records.

It can be read from any FEBio 4 file, even one with features that `read_feb` rejects, as FEBio itself checks
those.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from limbcli.errors import CaseError
from limbcli.feb.info import read_info
from limbcli.feb.read_control import MAJOR, OUTPUT_LEVELS, output_level
from limbcli.feb.read_mesh import Numbering
from limbcli.feb.read_output import check_form, is_read, listed_cells, listed_nodes, logged_body
from limbcli.feb.rigid_primary import contacts_without_force
from limbcli.feb.xml import LARGEST_ID, UNITS, VERSION, Tag, is_native, open_model, units_of
from limbcli.model import IntArray, LogRecord

_NEVER, _MINOR = 0, 2  # output levels


@dataclass(frozen=True, eq=False)
class Outline:
    """Outline of a model file.

    end_time : of the last step (s), or None if the file does not give it
    records : tables with a file of their own; `items` is the body's name, else None
    nodes, cells : table[id] = number from 0; records give nodes by number from 1, cells by id, as FEBio does
    must_points : global times listed under `<dtmax>`
    materials : numeric parameters by material id and name
    output_levels : of the steps, as FEBio numbers them
    bodies : names of the rigid bodies by material id, which their records contain
    without_force : contacts to which FEBio gives no force at all (`rigid_primary`)
    led_elsewhere : the file names its log or its plot file, which FEBio prefers to the run's own names
    has_touch_frame : limbcli's own model of a site: z = 0 is the height of the probe face at first touch
    """

    end_time: float | None
    records: tuple[LogRecord, ...]
    nodes: IntArray
    cells: IntArray
    must_points: tuple[float, ...]
    materials: Mapping[int, Mapping[str, float]] = field(default_factory=dict)
    output_levels: tuple[int, ...] = ()
    bodies: Mapping[str, str] = field(default_factory=dict)
    without_force: tuple[str, ...] = ()
    led_elsewhere: bool = False
    has_touch_frame: bool = False

    @property
    def n_nodes(self) -> int:
        return int(np.count_nonzero(self.nodes >= 0))

    @property
    def cell_ids(self) -> IntArray:
        """Ids (n_cells,) of the cells in the file, by number."""
        known = np.flatnonzero(self.cells >= 0)
        return np.asarray(known[np.argsort(self.cells[known])])


def read_outline(path: Path) -> Outline:
    """Read the outline.

    Raises CaseError if the file is absent, is not XML, or is not a FEBio 4.0 model in mm-N-s.
    """
    root = open_model(path)
    if not is_native(root):
        raise root.problem(
            f"it is of format {root.optional('version')} in {units_of(root)}, not of {VERSION} in {UNITS}",
            fix="write it anew, which converts it: write_feb(read_feb(path), other); `limbcli run` does so",
        )
    controls = [Tag(each, path) for each in root.element.iter("Control")]
    bodies = _bodies(root)
    nodes, cells = _table(root, "Mesh/Nodes/node"), _table(root, "Mesh/Elements/elem")
    return Outline(
        end_time=_end_time(controls),
        records=_records(root, bodies, nodes, cells),
        nodes=nodes,
        cells=cells,
        must_points=_must_points(root, controls),
        materials=_materials(root),
        output_levels=tuple(_output_level(each.child("output_level")) for each in controls),
        bodies=bodies,
        led_elsewhere=root.element.find("Output/*[@file]") is not None,
        without_force=contacts_without_force(root),
        has_touch_frame="patient_from_model" in read_info(root),
    )


def check_output(outline: Outline, path: Path) -> None:
    """Check that FEBio writes the model's records at converged times, and gives its contacts a force.

    Raises CaseError if it would write every iteration, or nothing at all, or elsewhere, or find no contact
    force.
    """
    if outline.led_elsewhere:
        raise CaseError(
            "<Output>: FEBio would write its log or plot file under the name that the file gives",
            where=str(path),
            fix='take file="..." out of <logfile> and <plotfile>; `limbcli run FILE` does so',
        )
    if outline.without_force:
        raise CaseError(
            "; ".join(outline.without_force),
            where=str(path),
            fix="make the soft surface the primary one, or give <auto_penalty>0</auto_penalty> and a penalty",
        )
    check_output_levels(outline, path)


def check_output_levels(outline: Outline, path: Path) -> None:
    """Check that the model's records are written, and at converged times only; CaseError if not."""
    levels = outline.output_levels
    if not outline.records or not levels or (_MINOR not in levels and set(levels) != {_NEVER}):
        return
    what = "writes what has not converged" if _MINOR in levels else "leaves the record files empty"
    raise CaseError(
        f"<output_level>: {OUTPUT_LEVELS[_MINOR if _MINOR in levels else _NEVER]} {what}",
        where=str(path),
        fix=f"give {OUTPUT_LEVELS[MAJOR]}, or omit it",
    )


def _output_level(tag: Tag | None) -> int:
    """The level, given by name or number; FEBio itself rejects anything else."""
    found = output_level(tag.text) if tag is not None else None
    return MAJOR if found is None else found


def _end_time(controls: list[Tag]) -> float | None:
    total = 0.0
    for control in controls:
        n_steps, size = control.child("time_steps"), control.child("step_size")
        if n_steps is None or size is None:
            return None
        total += n_steps.number() * size.number()
    return total or None


def _table(root: Tag, path: str) -> IntArray:
    rows = list(root.element.iterfind(path))
    try:
        ids = np.array([each.get("id") for each in rows], dtype=np.int64)
    except (ValueError, TypeError, OverflowError):
        ids = np.zeros(1, dtype=np.int64)
    if len(ids) and not 1 <= ids.min() <= ids.max() <= LARGEST_ID:
        ids = np.array([Tag(each, root.file).id_of() for each in rows], dtype=np.int64)
    return Numbering.of(ids)


def _materials(root: Tag) -> dict[int, dict[str, float]]:
    """Numeric parameters without a load curve or map; those of a material's parts are excluded."""
    found: dict[int, dict[str, float]] = {}
    for element in root.element.iterfind("Material/material"):
        tag = Tag(element, root.file)
        number = tag.optional("id") or ""
        if number.strip().isdigit():
            found[int(number)] = {
                each.name: value
                for each in tag
                if not each.attributes and (value := finite_number(each.text)) is not None
            }
    return found


def finite_number(text: str) -> float | None:
    """The number that a text states; None if it states none, or one that is not finite."""
    try:
        value = float(text)
    except ValueError:
        return None
    return value if np.isfinite(value) else None


def _must_points(root: Tag, controls: list[Tag]) -> tuple[float, ...]:
    times: set[float] = set()
    for control in controls:
        largest = control.element.find("time_stepper/dtmax")
        curve = largest.get("lc") if largest is not None else None
        for controller in root.element.iterfind("LoadData/load_controller"):
            if curve is not None and controller.get("id") == curve:
                times |= {Tag(each, root.file).numbers(2)[0] for each in controller.iterfind("points/*")}
    return tuple(sorted(times - {0.0}))


def _bodies(root: Tag) -> dict[str, str]:
    materials = enumerate(root.element.iterfind("Material/material"), start=1)
    return {
        each.get("id", ""): each.get("name") or f"material_{number}"
        for number, each in materials
        if each.get("type") == "rigid body"
    }


def _records(root: Tag, bodies: Mapping[str, str], nodes: IntArray, cells: IntArray) -> tuple[LogRecord, ...]:
    records = []
    for element in root.element.iterfind("Output/logfile/*"):
        tag = Tag(element, root.file)
        if not is_read(tag):
            continue
        check_form(tag)
        if tag.name == "node_data" and tag.optional("node_set") is None:
            listed_nodes(tag, nodes)
        if tag.name == "element_data" and tag.optional("elem_set") is None:
            listed_cells(tag, cells)
        fields = tuple(name.strip() for name in tag.attribute("data").split(";"))
        body = logged_body(tag, bodies) if tag.name == "rigid_body_data" else None
        records.append(LogRecord(tag.name.removesuffix("_data"), fields, tag.attribute("file"), body))  # type: ignore[arg-type]
    return tuple(records)
