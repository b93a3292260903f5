"""What reads a user's files: a good file each, who reads it, and what must hold of whatever was read."""

from __future__ import annotations

import gzip
import json
import shutil
import zipfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import meshio
import nibabel as nib
import numpy as np
import pydicom
import pydicom.data
from PIL import Image
from pydicom.uid import DeflatedExplicitVRLittleEndian

from limbcli.case import read_case
from limbcli.cohorts.column_checks import checked_cohort
from limbcli.errors.problems import errors_of
from limbcli.feb.log import check_complete, read_log
from limbcli.feb.outline import read_outline
from limbcli.feb.read import read_feb
from limbcli.feb.records import read_records
from limbcli.feb.runnable import runnable
from limbcli.imaging.dicom import read_series
from limbcli.imaging.image_files import read_image as read_image_file
from limbcli.imaging.label_files import read_label_file
from limbcli.imaging.surface import read_surface
from limbcli.imaging.volume import Volume
from limbcli.measurement.elastography import check_maps
from limbcli.measurement.indentation import check_levels, check_trace
from limbcli.measurement.load_cell_record import read_recording
from limbcli.measurement.ultrasound_image import read_image
from limbcli.meshing import surfaces
from limbcli.model.npz_file import load_model, save_model
from limbcli.results import open_stage, read_result, stage_folder
from limbcli.surface_formats.aop import AopLimb, write_aop
from tests.cohort_rows import HEADER, row
from tests.imaging.limb_images import dicom_seg
from tests.surface_formats.test_glb import write_glb

DATA = Path(__file__).resolve().parents[1] / "data" / "feb"
DICOM = Path(pydicom.data.__file__).parent / "test_files"
VTK = Path(__file__).resolve().parents[1] / "data" / "vtk"
CASES = Path(__file__).resolve().parents[2] / "cases"


@dataclass(frozen=True)
class Target:
    """name : of the kind of input; file : the one that is damaged, in the folder that `make` fills

    needs : a package that is not always installed
    sound : of what `read` gave: whether nothing impossible came through
    """

    name: str
    file: str
    text: bool
    make: Callable[[Path], None]
    read: Callable[[Path], Any]
    sound: Callable[[Any], bool] = lambda found: True
    needs: str = ""


def finite(values: Any) -> bool:
    return bool(np.isfinite(np.asarray(values, dtype=float)).all())


# ---------------------------------------------------------------- the good files


def make_case(folder: Path) -> None:
    (folder / "p1").mkdir(parents=True, exist_ok=True)
    shutil.copy(CASES / "phantom" / "case.toml", folder / "case.toml")
    (folder / "mri").mkdir(exist_ok=True)
    for name in ("levels.csv", "trace.csv"):
        (folder / "p1" / name).write_text("a\n")
    (folder / "p1" / "swe").mkdir(exist_ok=True)


def make_levels(folder: Path) -> None:
    rows = [f"{2 * k},{2.5 * k**0.8:.3f},{1.6 + 0.2 * k:.2f},0.2,90,load,5,{30 - 2 * k}" for k in range(8)]
    header = "force_n,depth_mm,swe_mean_m_per_s,swe_sd_m_per_s,swe_pixels,phase,hold_s,skin_bone_mm"
    (folder / "levels.csv").write_text("\n".join([header, *rows]) + "\n")


def make_trace(folder: Path) -> None:
    rows = [f"{k / 60:.4f},{min(k / 20, 6):.3f},{min(k / 30, 4):.3f}" for k in range(200)]
    (folder / "trace.csv").write_text("\n".join(["time_s,force_n,depth_mm", *rows]) + "\n")


def make_lvm(folder: Path) -> None:
    """A LabVIEW record with its own headers and decimal commas."""
    head = ["LabVIEW Measurement", "Separator\tTab", "Decimal_Separator\t,", "***End_of_Header***", "",
            "Channels\t1", "***End_of_Header***", "time_s\tforce_n\tComment"]  # fmt: skip
    rows = [f"{k / 60:.4f}\t{min(k / 20, 6):.3f}".replace(".", ",") for k in range(200)]
    (folder / "record.lvm").write_text("\n".join([*head, *rows]) + "\n")


def make_picture(folder: Path) -> None:
    y, x = np.mgrid[:60, :80]
    Image.fromarray(np.stack([x, y, x + y], axis=2).astype(np.uint8)).save(folder / "image.png")


def copy_of(name: str, to: str) -> Callable[[Path], None]:
    def make(folder: Path) -> None:
        shutil.copy(DICOM / name, folder / to)

    return make


def make_maps(folder: Path) -> None:
    rows = [f"{x},{y},{1.6 + 0.02 * y}" for x in range(-8, 9, 2) for y in range(4, 20, 2)]
    for level in range(2):
        text = "\n".join(["lateral_mm,depth_mm,speed_m_per_s", *rows]) + "\n"
        (folder / f"level_{level:02d}.csv").write_text(text)


def make_dicom(name: str) -> Callable[[Path], None]:
    def make(folder: Path) -> None:
        dataset = pydicom.dcmread(DICOM / name)
        for k in range(4):
            dataset.ImagePositionPatient = [0, 0, 4 * k]
            dataset.ImageOrientationPatient = [1, 0, 0, 0, 1, 0]
            dataset.PixelSpacing, dataset.Modality = [1, 1], "MR"
            dataset.SOPInstanceUID = f"1.2.3.{k}"
            dataset.save_as(folder / f"slice{k}.dcm")

    return make


def make_surface(name: str, **options: Any) -> Callable[[Path], None]:
    def make(folder: Path) -> None:
        phi, z = np.meshgrid(np.linspace(0, 2 * np.pi, 13)[:-1], np.linspace(0, 60, 5))
        points = np.c_[30 * np.cos(phi).ravel(), 30 * np.sin(phi).ravel(), z.ravel()]
        k = np.arange(48)
        right = 12 * (k // 12) + (k + 1) % 12
        faces = np.vstack([np.c_[k, right, right + 12], np.c_[k, right + 12, k + 12]])
        meshio.write(folder / name, meshio.Mesh(points, [("triangle", faces)]), **options)

    return make


def make_3mf(folder: Path) -> None:
    """A tetrahedron in inches, not packed, so that mutations reach its XML."""
    corners = ((0, 0, 0), (1, 0, 0), (0, 2, 0), (0, 0, 3))
    sides = ((0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2))
    points = "".join(f'<vertex x="{x}" y="{y}" z="{z}"/>' for x, y, z in corners)
    faces = "".join(f'<triangle v1="{a}" v2="{b}" v3="{c}"/>' for a, b, c in sides)
    core = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"
    kind = "http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"
    with zipfile.ZipFile(folder / "a.3mf", "w") as package:
        package.writestr("_rels/.rels", f'<R><Relationship Target="/a.model" Type="{kind}"/></R>')
        mesh = f"<mesh><vertices>{points}</vertices><triangles>{faces}</triangles></mesh>"
        item = '<item objectid="1" transform="1 0 0 0 1 0 0 0 1 5 6 7"/>'
        objects = f'<resources><object id="1">{mesh}</object></resources><build>{item}</build>'
        package.writestr("a.model", f'<model unit="inch" xmlns="{core}">{objects}</model>')


def _labels() -> np.ndarray:
    x, y = np.meshgrid(np.arange(24), np.arange(20), indexing="ij")
    radius = np.hypot(x - 12, y - 10)
    section = np.where(radius < 3, 2, np.where(radius < 9, 1, 0)).astype(np.uint8)
    return np.repeat(section[:, :, None], 10, axis=2)


def make_nifti(name: str) -> Callable[[Path], None]:
    def make(folder: Path) -> None:
        kind = nib.Nifti1Pair if name.endswith(".hdr") else nib.Nifti1Image
        image = kind(_labels(), np.diag([-2.0, -2.0, 4.0, 1.0]))
        image.header.set_xyzt_units("mm")
        nib.save(image, folder / name)

    return make


def make_placed_nifti(folder: Path) -> None:
    affine = np.diag([-2.0, -2.0, 4.0, 1.0])
    image = nib.Nifti1Image(_labels(), affine)
    image.set_sform(affine, code=1)
    image.set_qform(affine, code=1)
    nib.save(image, folder / "labels.nii")


def make_mgh(folder: Path) -> None:
    nib.save(nib.MGHImage(_labels(), np.diag([-2.0, -2.0, 4.0, 1.0])), folder / "labels.mgh")


def make_nrrd(folder: Path) -> None:
    header = (
        "NRRD0004\ntype: uint8\ndimension: 3\nspace: left-posterior-superior\nsizes: 24 20 10\n"
        "space directions: (2,0,0) (0,2,0) (0,0,4)\nendian: little\nencoding: raw\nspace origin: (0,0,0)\n\n"
    )
    (folder / "labels.nrrd").write_bytes(header.encode() + _labels().tobytes(order="F"))


def make_feb(folder: Path) -> None:
    shutil.copy(DATA / "punch.feb", folder / "model.feb")


def make_log(folder: Path) -> None:
    shutil.copy(DATA / "log-normal.txt", folder / "model.log")


def make_records(folder: Path) -> None:
    lines = []
    for step in range(4):
        lines += [f"*Step  = {step}", f"*Time  = {0.25 * step:g}", "*Data  = ux;uy;uz"]
        lines += [f"{k},{0.1 * k * step:.6g},0,{-0.2 * step:.6g}" for k in range(1, 12)]
    (folder / "nodes.csv").write_text("\n".join(lines) + "\n")


def make_model(folder: Path) -> None:
    save_model(read_feb(DATA / "punch.feb"), folder / "model.npz")


def make_tdms(folder: Path) -> None:
    import nptdms

    force = np.r_[np.zeros(40), np.linspace(0, 6, 80), np.full(80, 6.0)]
    with nptdms.TdmsWriter(folder / "record.tdms") as writer:
        wave = {"wf_increment": 1 / 60, "wf_start_offset": 0.0, "wf_samples": 1}
        channels = (("force_n", force, {"unit_string": "N"}), ("depth_mm", force / 2, {}))
        writer.write_segment(
            [nptdms.ChannelObject("rig", name, values, {**wave, **more}) for name, values, more in channels]
        )


def make_off(folder: Path) -> None:
    make_surface("a.ply", binary=False)(folder)
    found = read_surface(folder / "a.ply")
    rows = [" ".join(f"{each:.6g}" for each in point) for point in found.points]
    rows += ["3 " + " ".join(map(str, face)) for face in found.faces]
    head = f"OFF\n{len(found.points)} {len(found.faces)} 0\n"
    (folder / "a.off").write_text(head + "\n".join(rows) + "\n")


def make_aop(folder: Path) -> None:
    angles, heights = np.arange(0.0, 360.0, 30.0), np.arange(0.0, 60.0, 10.0)
    limb = AopLimb(angles, heights, np.full((6, 12), 30.0), "left", {"TIB": np.array([[0.0, 20.0]])})
    write_aop(folder / "a.aop", limb)


def make_mha(folder: Path) -> None:
    head = (
        "ObjectType = Image\nNDims = 3\nDimSize = 24 20 10\nElementType = MET_UCHAR\nBinaryData = True\n"
        "TransformMatrix = 1 0 0 0 1 0 0 0 1\nElementSpacing = 2 2 4\nOffset = 0 0 0\n"
        "CompressedData = True\nElementDataFile = LOCAL\n"
    )
    (folder / "labels.mha").write_bytes(head.encode() + zlib.compress(_labels().tobytes(order="F")))


def make_packed_nrrd(folder: Path) -> None:
    make_nrrd(folder)
    head, _, values = (folder / "labels.nrrd").read_bytes().partition(b"\n\n")
    head = head.replace(b"encoding: raw", b"encoding: gzip\nbyte skip: 16")
    (folder / "labels.nrrd").write_bytes(head + b"\n\n" + gzip.compress(bytes(16) + values))


def make_dicom_seg(folder: Path) -> None:
    truth = Volume(_labels(), np.diag([2.0, 2.0, 4.0, 1.0]))
    dicom_seg(folder / "labels.dcm", truth, {"Soft tissue": 1, "Bone": 2})


def make_deflated(folder: Path) -> None:
    make_dicom("MR_small.dcm")(folder)
    dataset = pydicom.dcmread(folder / "slice2.dcm")
    dataset.file_meta.TransferSyntaxUID = DeflatedExplicitVRLittleEndian
    dataset.save_as(folder / "slice2.dcm")


_LOADS = """<Loads><surface_load name="a" type="pressure" surface="skin"><pressure lc="1">0.001</pressure>
<linear>1</linear></surface_load><nodal_load type="nodal_load" node_set="skin"><dof>y</dof>
<scale lc="1">3</scale></nodal_load><body_load type="body force"><force>0,0,9.81</force></body_load></Loads>
"""


def make_loaded_feb(folder: Path) -> None:
    text = (DATA / "punch.feb").read_text().replace("<Boundary>", f"{_LOADS}<Boundary>", 1)
    (folder / "model.feb").write_text(text)


def make_packed_feb(folder: Path) -> None:
    (folder / "model.feb.gz").write_bytes(gzip.compress((DATA / "punch.feb").read_bytes()))


def copied(name: str) -> Callable[[Path], None]:
    def make(folder: Path) -> None:
        shutil.copy(VTK / name, folder / name)

    return make


RESULT = {
    "c_kpa": 8.5,
    "f_kappa": 21.0,
    "m": None,
    "interval_95": {"c_kpa": [7.1, 10.2]},
    "words": ["a", "b"],
}


def make_result(folder: Path) -> None:
    """A result of `fit` in the folder that `read_result` expects, and a copy of its record."""
    with open_stage(folder, "fit", subject="S1", site="p1") as writer:
        writer.data.update(RESULT)
        writer.summary.append("c 8.5 kPa")
        writer.file("curves", "curves.csv").write_text("depth_mm,force_n\n0,0\n1,0.5\n")
    shutil.copy(stage_folder(folder, "fit", "p1") / "fit.json", folder / "fit.json")


def read_own_result(path: Path) -> Any:
    shutil.copy(path, stage_folder(path.parent, "fit", "p1") / "fit.json")
    return read_result(path.parent, "fit", site="p1")


def make_cohort(folder: Path) -> None:
    rng = np.random.default_rng(7)
    rows = [
        row(f"P{k:03d}", "LL_P", 8.0 + rng.normal(), np.array([1.5, 7.0, 30.0]) * rng.uniform(0.9, 1.1, 3),
            np.array([0.1, 1.5, 5.0]), 0.0018)
        for k in range(8)
    ]  # fmt: skip
    lines = [",".join(HEADER), *(",".join(each[name] for name in HEADER) for each in rows)]
    (folder / "cohort.csv").write_text("\n".join(lines) + "\n")


def make_seg_nrrd(folder: Path) -> None:
    make_nrrd(folder)
    head, _, values = (folder / "labels.nrrd").read_bytes().partition(b"\n\n")
    names = (("Segment0", "Muscle", 1), ("Segment1", "Tibia", 2))
    pairs = "".join(f"{key}_Name:={name}\n{key}_LabelValue:={n}\n{key}_Layer:=0\n" for key, name, n in names)
    (folder / "labels.seg.nrrd").write_bytes(head + b"\n" + pairs.encode() + b"\n" + values)


# ---------------------------------------------------------------- what must hold of what was read


def sound_levels(found: Any) -> bool:
    levels, problems = found
    if levels is None or errors_of(problems):
        return True
    possible = (np.abs(levels.force) <= 150).all() and (np.abs(levels.depth) <= 60).all()
    return finite(levels.force) and finite(levels.depth) and bool(possible)


def sound_trace(found: Any) -> bool:
    trace, problems = found
    return trace is None or bool(errors_of(problems)) or (finite(trace.time) and finite(trace.force))


def sound_maps(found: Any) -> bool:
    maps, problems = found
    speeds = [each.speed_m_per_s for each in maps]
    return bool(errors_of(problems)) or all(finite(each) and (each > 0).all() for each in speeds)


def sound_volume(found: Any) -> bool:
    return finite(found.volume.affine) and finite(found.volume.values)


def sound_labels(found: Any) -> bool:
    return finite(found.affine) and set(np.unique(found.values)) <= {0, 1, 2, 3, 4}


def sound_faces(points: Any, faces: Any) -> bool:
    return finite(points) and len(faces) > 0 and bool((faces >= 0).all() and (faces < len(points)).all())


def sound_feb(model: Any) -> bool:
    cells = [block.cells for block in model.mesh.blocks]
    inside = all((each >= 0).all() and (each < len(model.mesh.points)).all() for each in cells)
    return finite(model.mesh.points) and inside


def sound_result(result: Any) -> bool:
    """A record that was changed and not noticed would be shown as it stands."""
    return dict(result.data) == json.loads(json.dumps(RESULT)) and result.summary == ("c 8.5 kPa",)


def sound_cohort(found: Any) -> bool:
    table, problems = found
    return table is None or bool(errors_of(problems)) or finite(table.force)


def read_whole_log(path: Path) -> Any:
    log = read_log(path)
    check_complete(log, path, end_time=1.0)
    return log


TARGETS = (
    Target("case.toml", "case.toml", True, make_case, lambda path: read_case(path.parent)),
    Target("levels.csv", "levels.csv", True, make_levels, check_levels, sound_levels),
    Target("trace.csv", "trace.csv", True, make_trace, check_trace, sound_trace),
    Target("SWE map", "level_01.csv", True, make_maps, lambda path: check_maps(path.parent), sound_maps),
    Target("load-cell record", "trace.csv", True, make_trace, read_recording,
           lambda found: finite(found.time) and bool((np.diff(found.time) > 0).all())),
    Target("LabVIEW record", "record.lvm", True, make_lvm, read_recording, lambda found: finite(found.time)),
    Target("picture", "image.png", False, make_picture, lambda path: read_image(path, mm_per_pixel=0.1)),
    Target("ultrasound DICOM", "a.dcm", False, copy_of("SC_rgb_rle.dcm", "a.dcm"),
           lambda path: read_image(path, mm_per_pixel=0.1)),
    Target("ultrasound JPEG", "a.dcm", False, copy_of("SC_rgb_jpeg_dcmtk.dcm", "a.dcm"),
           lambda path: read_image(path, mm_per_pixel=0.1)),
    *(
        Target(f"DICOM {name}", "slice2.dcm", False, make_dicom(f"{name}.dcm"),
               lambda path: read_series(path.parent), sound_volume)
        for name in ("MR_small", "CT_small", "MR_small_RLE", "MR_small_jp2klossless", "JPEG2000",
                     "MR_small_implicit", "MR_small_bigendian", "JPGExtended", "MR_small_jpeg_ls_lossless")
    ),
    *(
        Target(f"surface {name}", name, text, make_surface(name, **options), read_surface,
               lambda found: sound_faces(found.points, found.faces))
        for name, text, options in (
            ("a.stl", False, {"binary": True}), ("ascii.stl", True, {"binary": False}),
            ("a.ply", False, {"binary": True}), ("ascii.ply", True, {"binary": False}), ("a.obj", True, {}),
        )
    ),
    Target("GLB", "a.glb", False, lambda folder: write_glb(folder / "a.glb", [{"mesh": 0}]), read_surface,
           lambda found: sound_faces(found.points, found.faces)),
    Target("3MF", "a.3mf", False, make_3mf, read_surface,
           lambda found: sound_faces(found.points, found.faces)),
    Target("meshed surface", "b.ply", False, make_surface("b.ply", binary=True), surfaces.read_surface,
           lambda found: sound_faces(found.points, found.faces)),
    Target("NIfTI", "labels.nii", False, make_nifti("labels.nii"), read_label_file, sound_labels),
    Target("NIfTI, packed", "labels.nii.gz", False, make_nifti("labels.nii.gz"), read_label_file,
           sound_labels),
    Target("NIfTI pair", "labels.hdr", False, make_nifti("labels.hdr"), read_label_file, sound_labels),
    Target("MGH", "labels.mgh", False, make_mgh, read_label_file, sound_labels),
    Target("NRRD", "labels.nrrd", True, make_nrrd, read_label_file, sound_labels),
    Target("NIfTI image", "labels.nii", False, make_placed_nifti, read_image_file, sound_volume),
    Target("NRRD image", "labels.nrrd", True, make_nrrd, read_image_file, sound_volume),
    Target(".feb", "model.feb", True, make_feb, read_feb, sound_feb),
    Target(".feb, outline", "model.feb", True, make_feb, read_outline),
    Target("FEBio log", "model.log", True, make_log, read_whole_log),
    Target("records", "nodes.csv", True, make_records, lambda path: read_records(path, n_columns=3),
           lambda found: finite(found.values) and finite(found.times)),
    Target("model.npz", "model.npz", False, make_model, load_model, sound_feb),
    Target("TDMS record", "record.tdms", False, make_tdms, read_recording,
           lambda found: finite(found.time) and bool((np.diff(found.time) > 0).all()), needs="nptdms"),
    *(
        Target(f"surface {name}", name, text, make, read_surface,
               lambda found: sound_faces(found.points, found.faces))
        for name, text, make in (
            ("a.off", True, make_off), ("a.aop", True, make_aop), ("text.vtk", True, copied("text.vtk")),
            ("grid-binary.vtk", False, copied("grid-binary.vtk")), ("text.vtp", True, copied("text.vtp")),
            ("raw.vtp", False, copied("raw.vtp")), ("zlib.vtp", True, copied("zlib.vtp")),
            ("lz4.vtu", True, copied("lz4.vtu")), ("lzma.vtu", True, copied("lzma.vtu")),
        )
    ),
    Target("MetaImage", "labels.mha", False, make_mha, read_label_file, sound_labels),
    Target("MetaImage image", "labels.mha", False, make_mha, read_image_file, sound_volume),
    Target("NRRD, packed", "labels.nrrd", False, make_packed_nrrd, read_label_file, sound_labels),
    Target("segments NRRD", "labels.seg.nrrd", True, make_seg_nrrd, read_label_file, sound_labels),
    Target("DICOM SEG", "labels.dcm", False, make_dicom_seg, read_label_file, sound_labels),
    Target("DICOM, deflated", "slice2.dcm", False, make_deflated, lambda path: read_series(path.parent),
           sound_volume),
    Target(".feb, loads", "model.feb", True, make_loaded_feb, read_feb, sound_feb),
    Target(".feb, run", "model.feb", True, make_loaded_feb, runnable),
    Target(".feb.gz", "model.feb.gz", False, make_packed_feb, read_feb, sound_feb),
    Target("result", "fit.json", True, make_result, read_own_result, sound_result),
    Target("cohort table", "cohort.csv", True, make_cohort, checked_cohort, sound_cohort),
)  # fmt: skip
