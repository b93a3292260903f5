"""Read images and label maps with nibabel: NIfTI files and pairs, and FreeSurfer's MGH; RAS becomes LPS.

Formats: nifti.nimh.nih.gov/nifti-1 (qform, sform and their codes, xyzt_units); FreeSurfer's MghFormat
(surfer.nmr.mgh.harvard.edu/fswiki/FsTutorial/MghFormat). Analyze 7.5, of which NIfTI pairs have the names, is
refused: it has voxel sizes only, and programs disagree on which side of the image is the patient's left.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import nibabel as nib
import numpy as np
from nibabel.filebasedimages import ImageFileError
from nibabel.fileholders import FileHolder
from nibabel.freesurfer.mghformat import MGHError
from nibabel.imageglobals import logger as nibabel_logger
from nibabel.spatialimages import HeaderDataError
from nibabel.wrapstruct import WrapStructError
from numpy.typing import DTypeLike, NDArray
from pydicom.errors import InvalidDicomError

from limbcli.case.label_tables import names_by_number
from limbcli.errors import CaseError
from limbcli.files.detached_data import beside, image_of_pair
from limbcli.files.unpacking import DAMAGED, LIBRARY_ERRORS, UnpackingBudget
from limbcli.files.xml import own_text, parsed_xml
from limbcli.imaging.volume import MOST_VOXELS, RAS_FROM_LPS, Volume, require_placed

Opened = nib.Nifti1Pair | nib.MGHImage  # Nifti1Image and those of NIfTI-2 are Nifti1Pairs
# Fraction of the smallest side of a voxel: grids whose corners are this close are the same.
SAME_PLACE = 0.5
_FRAMES = {
    1: "the scanner's", 2: "aligned to another image", 3: "the Talairach atlas's",
    4: "the MNI 152 template's", 5: "another template's",
}  # fmt: skip
_HEADER = 540  # bytes, of NIfTI-2; NIfTI-1 has 348, MGH 90
_KINDS = {
    (348, b"n+1\0"): nib.Nifti1Image, (348, b"ni1\0"): nib.Nifti1Pair,
    (540, b"n+2\0"): nib.Nifti2Image, (540, b"ni2\0"): nib.Nifti2Pair,
}  # fmt: skip
_MGH = (".mgh", ".mgz")
_MGH_1, _GOOD_RAS = b"\0\0\0\1", slice(28, 30)  # its version, and where goodRASFlag is
_MOST_VALUES = 3 * MOST_VOXELS  # a map of directions has three in each voxel
_MOST_BEFORE, _MOST_AFTER = 100_000_000, 1_000_000  # bytes of a packed file before and after its values
_DAMAGED = (
    ImageFileError, HeaderDataError, WrapStructError, InvalidDicomError, MGHError, *DAMAGED, *LIBRARY_ERRORS,
)  # fmt: skip
_INTENT_LABEL = 1002  # NIFTI_INTENT_LABEL: values are numbers of labels
_ZOOM = 0.02  # largest relative difference of voxel sizes within one header
_SAVE = "save it again from 3D Slicer as NIfTI (.nii.gz)"
_PLACE = (
    "export it again from 3D Slicer with the DICOM series as its reference volume; for an image, "
    "dcm2niix does it too, or give the DICOM folder itself"
)


class _NoOrientationError(Exception):
    """Why a file does not define its orientation in the patient."""


def read_nifti(path: Path) -> Volume:
    """Read one scalar volume with its geometry, scaled by the header's slope and intercept, in patient LPS.

    Raises CaseError if the file cannot be read, contains several volumes, colours or complex numbers, or
    lacks its position; each with its own message.
    """
    image = open_nifti(path, noun="image")
    _require_one_scalar_volume(image, path)
    values = nifti_values(image, path, noun="image", dtype=np.float32)
    return Volume(values.reshape(image.shape[:3]), RAS_FROM_LPS @ image.affine)


def read_nifti_labels(path: Path) -> tuple[Volume, dict[int, str]]:
    """Read a label map in any numbers, in patient LPS, and the names that it gives them.

    Raises CaseError if the file cannot be read, or lacks its position in the patient frame.
    """
    image = open_nifti(path, noun="label map")
    values = nifti_values(image, path, noun="label map")
    while values.ndim > 3 and values.shape[-1] == 1:
        values = values[..., 0]
    return Volume(values, RAS_FROM_LPS @ image.affine), _label_names(image, path)


def open_nifti(path: Path, *, noun: str) -> Opened:
    """A NIfTI file or pair, or one of FreeSurfer's, packed or not, whose values are not yet read.

    noun : what the file is, for the messages ("image", "label map")

    Raises CaseError if it is none, damaged, or its packed content is not as long as its header says; if it
    does not say where it lies in the patient, or says it in two ways.
    """
    try:
        with _quiet():
            is_packed = path.name.lower().endswith((".gz", ".mgz"))
            image = _packed(path) if is_packed else _plain(path)
        header = image.header
        if isinstance(header, nib.Nifti1Header) and not (header["qform_code"] or header["sform_code"]):
            raise _NoOrientationError("qform_code and sform_code are 0")
    except _DAMAGED as error:
        raise _unreadable(path, noun, error) from error
    except _NoOrientationError as why:
        what = f"the {noun} does not define its orientation in the patient ({why})"
        raise CaseError(what, where=str(path), fix=_PLACE) from None
    _one_geometry(image, path, noun=noun)
    return image


def nifti_values(image: Opened, path: Path, *, noun: str, dtype: DTypeLike | None = None) -> NDArray:
    """The values of a file that `open_nifti` opened.

    Raises CaseError if they cannot be read, or are more than a limb's image can have.
    """
    if math.prod(image.shape[:3]) > MOST_VOXELS or math.prod(image.shape) > _MOST_VALUES:
        listed = " x ".join(map(str, image.shape[:3]))
        what = f"the {noun} has {listed} voxels, more than that of a limb can have"
        raise CaseError(what, where=str(path), fix="crop it to the limb")
    try:
        return np.asarray(image.dataobj, dtype=dtype)
    except _DAMAGED as error:
        raise _unreadable(path, noun, error) from error


@contextmanager
def _quiet() -> Iterator[None]:
    """Without nibabel's words on damaged headers, which its LoggingOutputSuppressor (5.4) lets through."""
    was, nibabel_logger.disabled = nibabel_logger.disabled, True
    try:
        yield
    finally:
        nibabel_logger.disabled = was


def _plain(path: Path) -> Opened:
    with path.open("rb") as stream:
        kind = _kind(stream.read(_HEADER), path)
    if kind not in (nib.Nifti1Pair, nib.Nifti2Pair):
        return kind.from_filename(path)
    values = image_of_pair(path)
    if values is None:
        raise ImageFileError("its values, the .img of the same name, are not beside it")
    return kind.from_file_map({"header": FileHolder(str(path)), "image": FileHolder(str(values))})


def _packed(path: Path) -> Opened:
    content = path.read_bytes()
    head = UnpackingBudget().gunzip(content, first=_HEADER)
    kind = _kind(head, path)
    if not issubclass(kind, nib.Nifti1Image | nib.MGHImage):
        raise ImageFileError("a pair of header and values is not packed into one file")
    header = kind.header_class(head[: kind.header_class.template_dtype.itemsize], check=False)
    begin, n_values = header.get_data_offset(), math.prod(max(1, n) for n in header.get_data_shape())
    if not 0 <= begin <= _MOST_BEFORE or n_values > _MOST_VALUES:
        raise ValueError(f"its data begin at byte {begin}, and are {n_values} values")
    n_bytes = begin + n_values * header.get_data_dtype().itemsize
    return kind.from_bytes(UnpackingBudget(n_bytes + _MOST_AFTER).gunzip(content))


def _kind(head: bytes, path: Path) -> type[nib.Nifti1Pair] | type[nib.MGHImage]:
    """The class for a file that begins like this: by the size of its header, in either order of bytes."""
    if path.suffix.lower() in _MGH and head.startswith(_MGH_1):
        if not any(head[_GOOD_RAS]):  # nibabel would set a default
            raise _NoOrientationError("goodRASFlag is 0")
        return nib.MGHImage
    sizes = {int.from_bytes(head[:4], order) for order in ("little", "big")}  # type: ignore[arg-type]
    magic = {348: head[344:348], 540: head[4:8]}
    for size in sizes & magic.keys():
        if path.suffix.lower() == ".hdr" and (size, magic[size]) not in _KINDS:
            raise _NoOrientationError("Analyze 7.5 has no field for it")
        return _KINDS.get((size, magic[size]), nib.Nifti1Image if size == 348 else nib.Nifti2Image)
    raise ImageFileError("it is not a NIfTI or MGH file")


def _unreadable(path: Path, noun: str, error: BaseException) -> CaseError:
    return CaseError(f"the {noun} cannot be read ({error})", where=str(path), fix=_SAVE)


def _require_one_scalar_volume(image: Opened, path: Path) -> None:
    kind, shape = image.get_data_dtype(), image.shape
    n_volumes = math.prod(shape[3:])
    one = "save only the T1-weighted volume (fslroi, or 3D Slicer), and give that file"
    several = f"holds {n_volumes} volumes ({len(shape)}-D: echoes, time points, directions)"
    flat = f"has {len(shape)} dimensions: a slice, not a volume"
    faults = [
        (kind.names is not None, f"holds colours ({'/'.join(kind.names or ())})", "export the grey values"),
        (kind.kind == "c", "holds complex numbers", "export its magnitude"),
        (n_volumes > 1, several, one),
        (len(shape) < 3, flat, "use the whole volume"),
    ]
    for is_so, what, fix in faults:
        if is_so:
            raise CaseError(f"the image {what}", where=str(path), fix=fix)


def _one_geometry(image: Opened, path: Path, *, noun: str) -> None:
    """Check that the voxel sizes and positions that a header states twice or more agree, and are in mm.

    With both qform and sform, nibabel uses the sform; ITK (5.4, itkNiftiImageIO) does so only where its code
    is 1, and shows the qform otherwise. Both must therefore give the same position, whatever their codes; one
    whose code is 0 is not there, for either.

    Raises CaseError naming the contradiction.
    """
    header = image.header
    fix = "export it again from 3D Slicer with the MRI series as its reference volume"
    affine = require_placed(image.affine, path, noun=noun)
    sides = np.linalg.norm(affine[:3, :3], axis=0)
    zooms = np.array(header.get_zooms()[:3], dtype=np.float64)
    if np.abs(zooms / np.maximum(sides[: len(zooms)], 1e-9) - 1).max() > _ZOOM:
        what = f"the {noun} gives two voxel sizes: {zooms.round(3)} mm (header), {sides.round(3)} mm (affine)"
        raise CaseError(what, where=str(path), fix=fix)
    if not isinstance(header, nib.Nifti1Header):
        return
    try:
        unit = header.get_xyzt_units()[0]
    except (KeyError, ValueError):
        unit = "not one that the format knows"
    if unit not in ("mm", "unknown"):
        raise CaseError(f"the {noun}'s unit of length is {unit}, not mm", where=str(path), fix=fix)
    try:
        qform, sform = header.get_qform(coded=True)[0], header.get_sform(coded=True)[0]
    except (ValueError, HeaderDataError) as error:
        what = f"the {noun}'s position (qform) cannot be read ({error})"
        raise CaseError(what, where=str(path), fix=fix) from error
    if qform is None or sform is None:
        return
    ends = np.array([[i, j, k, 1] for i in (0, 1) for j in (0, 1) for k in (0, 1)], dtype=np.float64)
    ends[:, :3] *= np.array((*header.get_data_shape(), 1, 1)[:3]) - 1
    off = float(np.linalg.norm(ends @ (qform - sform).T, axis=1).max())
    if off > SAME_PLACE * sides.min():
        what = (
            f"the {noun} gives two positions, up to {off:.2f} mm apart: "
            f"qform ({_frame(header, 'qform')}) and sform ({_frame(header, 'sform')})"
        )
        fix = f"{fix}; or, if you know which is right, write it to both (nibabel: set_qform, set_sform)"
        raise CaseError(what, where=str(path), fix=fix, off_mm=off)


def _frame(header: nib.Nifti1Header, which: str) -> str:
    """The code of qform or sform, and what it stands for."""
    code = int(header[f"{which}_code"])
    return f"code {code}, {_FRAMES.get(code, 'not one that the format knows')}"


def _label_names(image: Opened, path: Path) -> dict[int, str]:
    """Names that a NIfTI label map gives its numbers: in a label table in its header, or in a file beside it.

    The header's extension is XML with elements `<Label Key="1">name</Label>`, as TotalSegmentator 2 and
    Connectome Workbench write it. With intent code 1002 (NIFTI_INTENT_LABEL), `aux_file` may name a text file
    with lines of a number and a name.
    """
    header = image.header
    if not isinstance(header, nib.Nifti1Header):
        return {}
    for extension in header.extensions:
        content = extension.get_content()
        content = content if isinstance(content, bytes) else str(content).encode()
        if b"LabelTable" in content:
            try:
                return _label_table(content)
            except ValueError as error:
                raise CaseError(
                    f"the label map's table of names cannot be read ({error})", where=str(path), fix=_SAVE
                ) from error
    name = bytes(header["aux_file"]).rstrip(b"\0").decode("utf-8", "replace").strip()
    found = beside(path, name) if name and int(header["intent_code"]) == _INTENT_LABEL else None
    return names_by_number(found.read_text(encoding="utf-8", errors="replace")) if found else {}


def _label_table(content: bytes) -> dict[int, str]:
    """
    >>> _label_table(b'<a><LabelTable><Label Key="2"><![CDATA[tibia]]></Label></LabelTable></a>')
    {2: 'tibia'}
    """
    found = {}
    for each in parsed_xml(content.strip(b"\0 \r\n\t"), recover=True).iter("Label"):
        key = str(each.get("Key", ""))
        if key.lstrip("-").isdecimal() and own_text(each).strip():
            found[int(key)] = own_text(each).strip()
    return found
