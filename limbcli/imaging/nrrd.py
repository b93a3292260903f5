"""Read NRRD volumes as written by 3D Slicer (`.nrrd`, `.seg.nrrd`): label maps and images.

Format: teem.sourceforge.net/nrrd/format.html (NRRD0001 to NRRD0005, data in the file itself or in one file
beside it, encodings raw, gzip, bzip2 and ascii). Read here because pynrrd 1.1 skips bytes of packed data
twice, follows a data file out of the folder and unpacks without a limit; ITK 5.4 has no bzip2, and reads
files that do not define the patient's axes (`space dimension` in place of `space`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from limbcli.errors import CaseError
from limbcli.files.detached_data import beside
from limbcli.files.unpacking import DAMAGED, UnpackingBudget
from limbcli.imaging.volume import MOST_VOXELS, RAS_FROM_LPS, Volume, require_placed
from limbcli.model import Array

_TYPES = {
    "u1": ("uchar", "unsigned char", "uint8", "uint8_t"),
    "i1": ("signed char", "int8", "int8_t"),
    "i2": ("short", "short int", "signed short", "int16", "int16_t"),
    "u2": ("ushort", "unsigned short", "unsigned short int", "uint16", "uint16_t"),
    "i4": ("int", "signed int", "int32", "int32_t"),
    "u4": ("uint", "unsigned int", "uint32", "uint32_t"),
    "i8": ("longlong", "long long", "long long int", "signed long long", "int64", "int64_t"),
    "u8": ("ulonglong", "unsigned long long", "unsigned long long int", "uint64", "uint64_t"),
    "f4": ("float",),
    "f8": ("double",),
}
_TEXT = ("ascii", "text", "txt")
_PACKED = ("gzip", "gz", "bzip2", "bz2")
_LPS = ("left-posterior-superior", "lps")
_RAS = ("right-anterior-superior", "ras")
_MOST_SKIPPED = 1_000_000  # bytes of another format's header before packed data


@dataclass(frozen=True, eq=False)
class Nrrd:
    """values [i, j, k] or [layer, i, j, k]; affine from voxel to patient LPS; key/value pairs."""

    values: NDArray
    affine: Array
    pairs: dict[str, str]


def read_nrrd(path: Path, *, noun: str = "label map") -> Nrrd:
    """Read a NRRD file, or a NRRD header (`.nhdr`) with its data beside it.

    noun : what the file is, for the messages

    Raises CaseError if it is not NRRD, of an unsupported kind, or lacks its position; the message says which.
    """
    fields, pairs, data = _parts(path, noun)
    _check_geometry(fields, path, noun)
    try:
        values = _values(data, fields)
        layers = [n for n, each in enumerate(_directions(fields)) if each is None]
        if len(layers) > 1 or values.ndim != 3 + len(layers):
            raise ValueError(f"sizes {fields['sizes']} with space directions {fields['space directions']}")
        affine = _affine(fields)
    except DAMAGED as error:
        raise _refusal(path, f"cannot be read ({error})", noun) from error
    affine = require_placed(affine, path, noun=noun)
    return Nrrd(np.moveaxis(values, layers, [0] * len(layers)), affine, pairs)


def read_nrrd_image(path: Path) -> Volume:
    """Read one scalar volume of a NRRD file, in patient LPS.

    Raises CaseError if it cannot be read, contains several volumes or colours, or lacks its position; each
    with its own message.
    """
    fields, _, _ = _parts(path, "image")
    kinds = fields.get("kinds", "").lower().split()
    colours = [each for each in kinds if "color" in each or each.startswith(("rgb", "hsv", "xyz"))]
    if colours:
        raise CaseError(
            f"the image holds colours ({colours[0]}), not a signal",
            where=str(path),
            fix="export the grey values",
        )
    if len(fields.get("sizes", "").split()) > 3:
        raise CaseError(
            f"the image holds several volumes ({fields['sizes']}: echoes, time points, directions)",
            where=str(path),
            fix="save only the T1-weighted volume from 3D Slicer, and give that file",
        )
    found = read_nrrd(path, noun="image")
    return Volume(found.values, found.affine)


def _check_geometry(fields: dict[str, str], path: Path, noun: str) -> None:
    """Check the space in which the directions of the axes are given, and that its unit is mm."""
    if "space" not in fields or "space directions" not in fields:
        lacking = "space" if "space" not in fields else "space directions"
        raise CaseError(
            f"the {noun} does not define its orientation in the patient (no field `{lacking}`)",
            where=str(path),
            fix="save it again from 3D Slicer" + (", or give the DICOM folder itself" * (noun == "image")),
        )
    if "none" in fields.get("space origin", "none").lower():
        raise CaseError(
            f"the {noun} does not define its position in the patient (no field `space origin`)",
            where=str(path),
            fix="save it again from 3D Slicer; or, where no other file shares its position, add the line "
            "space origin: (0,0,0) to its header",
        )
    units = {each.strip('" ').lower() for each in fields.get("space units", "mm").split()}
    if not units <= {"mm", "millimeter", "millimeters"}:
        what = f"the {noun}'s unit of length is {', '.join(sorted(units))}, not mm"
        raise CaseError(what, where=str(path), fix="save it again in mm")


def _parts(path: Path, noun: str) -> tuple[dict[str, str], dict[str, str], bytes]:
    """Fields and key/value pairs of the header, and the data."""
    try:
        content = path.read_bytes()
    except OSError as error:
        raise _refusal(path, f"cannot be read ({error.strerror})", noun) from error
    end, skip = content.find(b"\n\n"), 2
    if b"\r\n\r\n" in content[:65536] and (end < 0 or content.find(b"\r\n\r\n") < end):
        end, skip = content.find(b"\r\n\r\n"), 4
    if end < 0:
        end = len(content)  # a header alone may end without an empty line
    fields, pairs = _header(content[:end].decode("utf-8", "replace"))
    name = fields.get("data file", fields.get("datafile"))
    if not content.startswith(b"NRRD000") or (end == len(content) and name is None):
        raise _refusal(path, "is not a NRRD file", noun)
    if name is None:
        return fields, pairs, content[end + skip :]
    return fields, pairs, read_beside(path, name, noun=noun)


def read_beside(header: Path, name: str, *, noun: str) -> bytes:
    """The content of the file with the data of a header.

    Raises CaseError if the header names several files, or one that is not in its folder.
    """
    found = beside(header, name)
    if found is None:
        several = name.upper().startswith("LIST") or "%" in name
        what = f"the {noun}'s data are in several files"
        if not several:
            what = f"the {noun} has its data in a separate file, which is not beside it"
        fix = "save it again as one file" if several else f"put it into the folder of {header.name}"
        raise CaseError(f"{what} ({name})", where=str(header), fix=f"{fix}, or save it as .nrrd or .nii.gz")
    try:
        return found.read_bytes()
    except OSError as error:
        raise _refusal(found, f"cannot be read ({error.strerror})", noun) from error


def _refusal(path: Path, what: str, noun: str) -> CaseError:
    names = ".nrrd or .seg.nrrd" if noun == "label map" else ".nrrd"
    fix = f"save it again from 3D Slicer as {names} (compressed or not), or as NIfTI"
    return CaseError(f"the {noun} {what}", where=str(path), fix=fix)


def _header(text: str) -> tuple[dict[str, str], dict[str, str]]:
    fields, pairs = {}, {}
    for line in text.splitlines()[1:]:
        if line.startswith("#"):
            continue
        if ":=" in line:
            key, _, value = line.partition(":=")
            pairs[key.strip()] = value.strip()
        elif ":" in line:
            key, _, value = line.partition(":")
            fields[key.strip().lower()] = value.strip()
    return fields, pairs


def _values(data: bytes, fields: dict[str, str]) -> NDArray:
    sizes = [int(each) for each in fields["sizes"].split()]
    kind = next((code for code, names in _TYPES.items() if fields["type"].lower() in names), None)
    if kind is None:
        raise ValueError(f"type {fields['type']}")
    count = math.prod(sizes)
    if min(sizes, default=0) < 1 or count > MOST_VOXELS:
        raise ValueError(f"sizes {fields['sizes']}")
    encoding = fields.get("encoding", "raw").lower()
    data = _after_lines(data, int(fields.get("line skip", fields.get("lineskip", "0"))))
    skip = int(fields.get("byte skip", fields.get("byteskip", "0")))
    if skip < -1 or (skip and encoding in _TEXT) or (skip == -1 and encoding != "raw"):
        raise ValueError(f"byte skip {skip} with encoding {encoding}")
    if encoding in _TEXT:
        return np.array(data.split(), dtype=float).reshape(sizes, order="F")
    if encoding in _PACKED:
        if skip > _MOST_SKIPPED:
            raise ValueError(f"byte skip {skip} in packed data")
        budget = UnpackingBudget(8 * count + skip)
        data = budget.gunzip(data) if encoding in ("gzip", "gz") else budget.bunzip2(data)
    elif encoding != "raw":
        raise ValueError(f"encoding {encoding}")
    order = ">" if fields.get("endian", "little").lower() == "big" else "<"
    dtype = np.dtype(order + kind)
    begin = max(len(data) - count * dtype.itemsize, 0) if skip == -1 else skip
    return np.frombuffer(data[begin:], dtype=dtype, count=count).reshape(sizes, order="F")


def _after_lines(data: bytes, n: int) -> bytes:
    """What follows the first n lines.

    >>> _after_lines(b"a line\\nand this", 1)
    b'and this'
    """
    for _ in range(n):
        _, newline, data = data.partition(b"\n")
        if not newline:
            raise ValueError(f"line skip {n}, where there are fewer lines")
    return data


def _directions(fields: dict[str, str]) -> list[list[float] | None]:
    """Direction of each axis; None for an axis that is not spatial."""
    return [_vector(each) for each in fields["space directions"].replace("none", "(none)").split(") ")]


def _affine(fields: dict[str, str]) -> Array:
    columns = [each for each in _directions(fields) if each is not None]
    if len(columns) != 3:
        raise ValueError("space directions of three axes are needed")
    affine = np.eye(4)
    affine[:3, :3] = np.array(columns).T
    affine[:3, 3] = _vector(fields["space origin"])
    space = fields["space"].lower()
    if space in _RAS:
        affine = RAS_FROM_LPS @ affine
    elif space not in _LPS:
        raise ValueError(f"space {space}")
    return affine


def _vector(text: str) -> list[float] | None:
    inner = text.strip().strip("()")
    return None if inner == "none" else [float(each) for each in inner.split(",")]
