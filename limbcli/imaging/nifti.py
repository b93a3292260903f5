"""Read images from NIfTI volumes, check their geometry and convert it from RAS to LPS.

Format: nifti.nimh.nih.gov/nifti-1 (qform, sform and their codes, xyzt_units).
"""

from __future__ import annotations

import math
from pathlib import Path

import nibabel as nib
import numpy as np
from nibabel.filebasedimages import ImageFileError
from nibabel.imageglobals import LoggingOutputSuppressor
from nibabel.spatialimages import HeaderDataError
from nibabel.wrapstruct import WrapStructError
from pydicom.errors import InvalidDicomError

from limbcli.case.label_tables import names_by_number
from limbcli.errors import CaseError
from limbcli.files.detached_data import beside
from limbcli.files.unpacking import DAMAGED as NOT_UNPACKED
from limbcli.files.unpacking import UnpackingBudget
from limbcli.files.xml import own_text, parsed_xml
from limbcli.imaging.volume import DAMAGED, MOST_VOXELS, RAS_FROM_LPS, Volume, require_placed

# Fraction of the smallest side of a voxel: grids whose corners are this close are the same.
SAME_PLACE = 0.5
_FRAMES = {
    1: "the scanner's", 2: "aligned to another image", 3: "the Talairach atlas's",
    4: "the MNI 152 template's", 5: "another template's",
}  # fmt: skip
_HEADER = 540  # bytes, of NIfTI-2; NIfTI-1 has 348
_MOST_BEFORE, _MOST_AFTER = 100_000_000, 1_000_000  # bytes of a packed file before and after its values
NIFTI_DAMAGED = (
    ImageFileError, HeaderDataError, WrapStructError, InvalidDicomError, *DAMAGED, *NOT_UNPACKED,
)  # fmt: skip
_INTENT_LABEL = 1002  # NIFTI_INTENT_LABEL: values are numbers of labels
_ZOOM = 0.02  # largest relative difference of voxel sizes within one header
_SAVE = "save it again from 3D Slicer as NIfTI (.nii.gz)"


def read_nifti(path: Path) -> Volume:
    """Read one scalar volume with its geometry, scaled by the header's slope and intercept.

    Raises
    ------
    CaseError
        If the file cannot be read, contains several volumes, colours or complex numbers, or lacks its
        position; each with its own message.
    """
    image = _opened(path)
    _scalar(image, path)
    shape = _one_volume(tuple(image.shape), path)
    if math.prod(shape) > MOST_VOXELS:
        raise CaseError(
            f"the image has {' x '.join(map(str, shape))} voxels, more than a limb image can have",
            where=str(path),
            fix="crop it to the limb",
        )
    fix = "convert the DICOM series again (dcm2niix writes both), or give the DICOM folder itself"
    require_placement(image, path, noun="image", fix=fix)
    one_geometry(image, path, noun="image")
    try:
        values = np.asarray(image.dataobj, dtype=np.float32).reshape(shape)
    except NIFTI_DAMAGED as error:
        raise _unreadable(path, error) from error
    return Volume(values, RAS_FROM_LPS @ np.asarray(image.affine, dtype=np.float64))


def open_nifti(path: Path) -> nib.Nifti1Image:
    """A NIfTI-1 or NIfTI-2 file, packed or not, whose values are not yet read; nothing else is tried.

    Raises
    ------
    One of `NIFTI_DAMAGED`
        If it is none, damaged, too large, or its packed content is not as long as its header says.
    """
    with LoggingOutputSuppressor():  # it writes damaged headers to the terminal
        return _packed(path) if path.name.lower().endswith(".gz") else _plain(path)


def _plain(path: Path) -> nib.Nifti1Image:
    with path.open("rb") as stream:
        return _kind(stream.read(_HEADER)).from_filename(path)


def _packed(path: Path) -> nib.Nifti1Image:
    content = path.read_bytes()
    head = UnpackingBudget().gunzip(content, first=_HEADER)
    kind = _kind(head).header_class
    header = kind(head[: kind.sizeof_hdr], check=False)
    begin, n_values = float(header["vox_offset"]), math.prod(max(1, n) for n in header.get_data_shape())
    if not 0 <= begin <= _MOST_BEFORE or n_values > 3 * MOST_VOXELS:
        raise ValueError(f"its data begin at byte {begin:g}, and are {n_values} values")
    n_bytes = int(begin) + n_values * header.get_data_dtype().itemsize
    return _kind(head).from_bytes(UnpackingBudget(n_bytes + _MOST_AFTER).gunzip(content))


def _kind(head: bytes) -> type[nib.Nifti1Image]:
    """The class for a file that begins like this: by the size of its header, in either order of bytes."""
    sizes = {int.from_bytes(head[:4], order) for order in ("little", "big")}  # type: ignore[arg-type]
    found = {348: nib.Nifti1Image, 540: nib.Nifti2Image}
    kind = next((found[size] for size in sizes if size in found), None)
    if kind is None:
        raise ImageFileError("it is not a NIfTI file")
    return kind


def _opened(path: Path) -> nib.Nifti1Image:
    try:
        return open_nifti(path)
    except NIFTI_DAMAGED as error:
        raise _unreadable(path, error) from error


def _unreadable(path: Path, error: BaseException) -> CaseError:
    return CaseError(f"the image cannot be read ({error})", where=str(path), fix=_SAVE)


def _scalar(image: nib.Nifti1Image, path: Path) -> None:
    kind = image.get_data_dtype()
    if kind.names is not None:
        what = f"the image holds colours ({'/'.join(kind.names)}), not a signal"
        raise CaseError(what, where=str(path), fix="export the grey values")
    if kind.kind == "c":
        what = "the image holds complex numbers"
        raise CaseError(what, where=str(path), fix="export its magnitude")


def _one_volume(shape: tuple[int, ...], path: Path) -> tuple[int, int, int]:
    extra = math.prod(shape[3:])
    if len(shape) > 3 and extra > 1:
        raise CaseError(
            f"the image holds {extra} volumes ({len(shape)}-D: echoes, time points, directions)",
            where=str(path),
            fix="save only the T1-weighted volume (fslroi, or 3D Slicer), and give that file",
            n_volumes=extra,
        )
    if len(shape) < 3:
        raise CaseError(
            f"the image has {len(shape)} dimensions: a slice, not a volume",
            where=str(path),
            fix="use the whole volume",
        )
    return int(shape[0]), int(shape[1]), int(shape[2])


def require_placement(image: object, path: Path, *, noun: str, fix: str) -> None:
    """Refuse a NIfTI without qform and sform: it has voxel sizes only, so that left and right are unknown.

    Raises
    ------
    CaseError
        If it has neither.
    """
    header = getattr(image, "header", None)
    if isinstance(header, nib.Nifti1Header) and not header["qform_code"] and not header["sform_code"]:
        what = f"the {noun} does not define its orientation in the patient (qform_code and sform_code are 0)"
        raise CaseError(what, where=str(path), fix=fix)


def one_geometry(image: object, path: Path, *, noun: str) -> None:
    """Check that the voxel sizes and positions that a NIfTI header states twice or more agree, and are in mm.

    With both qform and sform, nibabel uses the sform; ITK (5.4, itkNiftiImageIO) does so only where its code
    is 1, and shows the qform otherwise. Both must therefore give the same position, whatever their codes; one
    whose code is 0 is not there, for either.

    noun : what the file is, for the messages ("image", "label map")

    Raises
    ------
    CaseError
        Naming the contradiction.
    """
    header = getattr(image, "header", None)
    if not isinstance(header, nib.Nifti1Header):
        return
    fix = "export it again from 3D Slicer with the MRI series as its reference volume"
    try:
        unit = header.get_xyzt_units()[0]
    except (KeyError, ValueError):
        unit = "not one that the format knows"
    if unit not in ("mm", "unknown"):
        raise CaseError(f"the {noun}'s unit of length is {unit}, not mm", where=str(path), fix=fix)
    affine = require_placed(image.affine, path, noun=noun)  # type: ignore[attr-defined]
    sides = np.linalg.norm(affine[:3, :3], axis=0)
    zooms = np.array(header.get_zooms()[:3], dtype=np.float64)
    if np.abs(zooms / np.maximum(sides, 1e-9) - 1).max() > _ZOOM:
        what = f"the {noun} gives two voxel sizes: {zooms.round(3)} mm (pixdim), {sides.round(3)} mm (affine)"
        raise CaseError(what, where=str(path), fix=fix)
    try:
        qform, sform = header.get_qform(coded=True)[0], header.get_sform(coded=True)[0]
    except (ValueError, HeaderDataError) as error:
        what = f"the {noun}'s position (qform) cannot be read ({error})"
        raise CaseError(what, where=str(path), fix=fix) from error
    if qform is None or sform is None:
        return
    ends = np.array([[i, j, k, 1] for i in (0, 1) for j in (0, 1) for k in (0, 1)], dtype=np.float64)
    ends[:, :3] *= np.array(header.get_data_shape()[:3]) - 1
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


def label_names_of(image: object, path: Path) -> dict[int, str]:
    """Names that a NIfTI label map gives its numbers: in a label table in its header, or in a file beside it.

    The header's extension is XML with elements `<Label Key="1">name</Label>`, as TotalSegmentator 2 and
    Connectome Workbench write it. With intent code 1002 (NIFTI_INTENT_LABEL), `aux_file` may name a text file
    with lines of a number and a name.
    """
    header = getattr(image, "header", None)
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
