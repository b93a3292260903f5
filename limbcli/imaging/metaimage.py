"""Read MetaImage volumes (`.mha`, or `.mhd` with its data beside it), as ITK and 3D Slicer write them.

Format: itk.org/Wiki/ITK/MetaIO/Documentation. Positions are in patient LPS, as ITK reads them; every row of
TransformMatrix is the direction of one axis. Read here because ITK 5.4 takes a missing TransformMatrix or
ElementSpacing for the identity or 1 mm, and returns arbitrary values of packed data of unstated size.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from limbcli.errors import CaseError
from limbcli.files.unpacking import DAMAGED, UnpackingBudget
from limbcli.imaging.nrrd import read_beside
from limbcli.imaging.volume import MOST_VOXELS, Volume, require_placed, require_unit_directions
from limbcli.model import Array

_TYPES = {
    "MET_CHAR": "i1", "MET_UCHAR": "u1", "MET_SHORT": "i2", "MET_USHORT": "u2", "MET_INT": "i4",
    "MET_UINT": "u4", "MET_LONG_LONG": "i8", "MET_ULONG_LONG": "u8", "MET_FLOAT": "f4", "MET_DOUBLE": "f8",
}  # fmt: skip
_LAST_KEY = "ElementDataFile"
_PLACES = ("Offset", "Position", "Origin")
_LONGEST = 65536  # bytes of a header
_SAVE = "save it again from 3D Slicer as NIfTI (.nii.gz) or .nrrd"


def read_metaimage(path: Path, *, noun: str = "image") -> Volume:
    """Read one scalar volume of a MetaImage, in patient LPS.

    noun : what the file is, for the messages ("image", "label map")

    Raises CaseError if it cannot be read, holds several values per voxel, or lacks its position.
    """
    try:
        content = path.read_bytes()
        fields, data = _parts(content)
    except (OSError, ValueError) as error:
        raise _refusal(path, f"cannot be read ({error})", noun) from error
    if fields.get("ElementNumberOfChannels", "1") != "1":
        count = fields["ElementNumberOfChannels"]
        raise CaseError(
            f"the {noun} has {count} values per voxel", where=str(path), fix="save one scalar volume"
        )
    if _matrix_key(fields) is None:
        what = f"the {noun} does not define its orientation in the patient (no field `TransformMatrix`)"
        raise CaseError(what, where=str(path), fix=_SAVE)
    if not any(key in fields for key in _PLACES):
        what = f"the {noun} does not define its position in the patient (no field `Offset`)"
        fix = f"{_SAVE}; or, where no other file shares its position, add the line Offset = 0 0 0"
        raise CaseError(what, where=str(path), fix=fix)
    name = fields[_LAST_KEY]
    if name.upper() != "LOCAL":
        data = read_beside(path, name, noun=noun)
    try:
        values, affine, directions = _values(data, fields), _affine(fields), _directions(fields)
    except DAMAGED as error:
        raise _refusal(path, f"cannot be read ({error})", noun) from error
    affine = require_placed(affine, path, noun=noun)
    require_unit_directions(directions, where=str(path), what="TransformMatrix", fix=_SAVE)
    return Volume(values, affine)


def _refusal(path: Path, what: str, noun: str) -> CaseError:
    return CaseError(f"the {noun} {what}", where=str(path), fix=_SAVE)


def _parts(content: bytes) -> tuple[dict[str, str], bytes]:
    """Fields of the header, which ends with the line of `ElementDataFile`, and what follows it."""
    fields, at = {}, 0
    while at < min(len(content), _LONGEST):
        end = content.find(b"\n", at)
        line = content[at : end if end >= 0 else len(content)]
        at = end + 1 if end >= 0 else len(content)
        key, equals, value = line.decode("ascii", "replace").partition("=")
        if not equals:
            break
        fields[key.strip()] = value.strip()
        if key.strip() == _LAST_KEY:
            return fields, content[at:]
    raise ValueError("it is not a MetaImage: no line ElementDataFile")


def _values(data: bytes, fields: dict[str, str]) -> NDArray:
    sizes = [int(each) for each in fields["DimSize"].split()]
    if len(sizes) != 3 or min(sizes) < 1 or math.prod(sizes) > MOST_VOXELS:
        raise ValueError(f"DimSize {fields['DimSize']}")
    if fields["ElementType"] not in _TYPES:
        raise ValueError(f"ElementType {fields['ElementType']}")
    if not _is_true(fields, "BinaryData", "True"):
        return np.array(data.split(), dtype=float).reshape(sizes, order="F")
    order = ">" if any(_is_true(fields, f"{key}ByteOrderMSB") for key in ("BinaryData", "Element")) else "<"
    dtype = np.dtype(order + _TYPES[fields["ElementType"]])
    n_bytes = math.prod(sizes) * dtype.itemsize
    skip = int(fields.get("HeaderSize", "0"))
    data = data[max(len(data) - n_bytes, 0) if skip == -1 else skip :]
    if _is_true(fields, "CompressedData"):
        data = UnpackingBudget().inflate(data, n_bytes)
    if len(data) < n_bytes:
        raise ValueError(f"{len(data)} of {n_bytes} bytes of data")
    return np.frombuffer(data, dtype=dtype, count=math.prod(sizes)).reshape(sizes, order="F")


def _is_true(fields: dict[str, str], key: str, default: str = "False") -> bool:
    return fields.get(key, default).lower() in ("true", "1")


def _matrix_key(fields: dict[str, str]) -> str | None:
    return next((key for key in ("TransformMatrix", "Rotation", "Orientation") if key in fields), None)


def _directions(fields: dict[str, str]) -> Array:
    """The directions of the axes, one in each row (3, 3)."""
    words = fields[_matrix_key(fields) or "TransformMatrix"].split()
    return np.array(words, dtype=float).reshape(3, 3)


def _affine(fields: dict[str, str]) -> Array:
    """
    >>> fields = {"TransformMatrix": "0 1 0 -1 0 0 0 0 1", "Offset": "5 6 7", "ElementSpacing": "2 3 4"}
    >>> _affine(fields)[:3]
    array([[ 0., -3.,  0.,  5.],
           [ 2.,  0.,  0.,  6.],
           [ 0.,  0.,  4.,  7.]])
    """
    spacing = np.array(fields.get("ElementSpacing", fields.get("ElementSize", "")).split(), dtype=float)
    place = next(fields[key] for key in _PLACES if key in fields)
    if spacing.shape != (3,) or (spacing < 0).any():
        raise ValueError("no ElementSpacing of three positive numbers")
    affine = np.eye(4)
    affine[:3, :3] = _directions(fields).T * spacing
    affine[:3, 3] = np.array(place.split(), dtype=float).reshape(3)
    return affine
