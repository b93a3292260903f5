"""Label maps with numbers and names of their own: the same limb as in our numbers, voxel for voxel."""

from __future__ import annotations

import re
import zlib

import nibabel as nib
import numpy as np
import pytest
from limb_images import Limb
from scipy import ndimage
from scipy.spatial.transform import Rotation

from limbcli.case.label_sources import LabelSource, read_label_sources
from limbcli.case.reading import CaseReading
from limbcli.errors import CaseError
from limbcli.files.atomic import sha256
from limbcli.imaging.label_files import label_lines, read_label_file, read_label_map
from limbcli.imaging.label_names import PRESETS, meaning_of, preset_of
from limbcli.imaging.labels import segmentation_from
from limbcli.imaging.metaimage import read_metaimage
from limbcli.imaging.volume import RAS_FROM_LPS, Volume


@pytest.fixture(scope="module")
def truth():
    turned = Rotation.from_euler("xyz", [4, -6, 9], degrees=True).as_matrix()
    image, labels = Limb(markers=((43.5, 0.0, -8.0),)).image(
        shape=(52, 46, 10), spacing=(2, 2, 4), rotation=turned, samples=1
    )
    return Volume(labels.astype(np.uint8), image.affine)


def nifti(path, volume, *, names=None, intent=None, aux=""):
    affine = RAS_FROM_LPS @ volume.affine
    image = nib.Nifti1Image(volume.values, affine)
    image.header.set_xyzt_units("mm")
    image.set_sform(affine, code=1)
    image.set_qform(affine, code=1)
    if names:
        rows = "".join(f'<Label Key="{n}" Red="1"><![CDATA[{name}]]></Label>\n' for n, name in names.items())
        text = f"<CaretExtension><LabelTable>{rows}</LabelTable></CaretExtension>\n  "
        image.header.extensions.append(nib.nifti1.Nifti1Extension(0, text.encode()))
    if intent:
        image.header.set_intent(intent)
        image.header["aux_file"] = aux.encode()
    nib.save(image, path)
    return path


def renumbered(truth, numbers):
    """The truth with other numbers: {ours: theirs}."""
    values = np.zeros(truth.values.shape, np.int16)
    for ours, theirs in numbers.items():
        values[truth.values == ours] = theirs
    return truth.with_values(values)


def two_bones(truth):
    """The truth as int16, with 20 for the tibia and 30 for the fibula."""
    first = segmentation_from(truth).bones[0]
    values = truth.values.astype(np.int16)
    turned, _, _ = truth.along_limb()
    assert turned.values.shape == first.values.shape
    values[truth.values == 2] = 30
    values[first.values & (truth.values == 2)] = 20
    return truth.with_values(values)


def metaimage(path, volume, *, is_compressed=False, drop=""):
    directions = " ".join(f"{x:.12g}" for x in (volume.affine[:3, :3] / volume.spacing).T.ravel())
    data = volume.values.astype("<i2").tobytes(order="F")
    data = zlib.compress(data) if is_compressed else data
    local = path.suffix == ".mha"
    fields = {
        "ObjectType": "Image", "NDims": "3", "BinaryData": "True", "BinaryDataByteOrderMSB": "False",
        "CompressedData": str(is_compressed), "TransformMatrix": directions,
        "Offset": " ".join(f"{x:.12g}" for x in volume.affine[:3, 3]),
        "ElementSpacing": " ".join(f"{x:.12g}" for x in volume.spacing),
        "DimSize": " ".join(map(str, volume.shape)), "ElementType": "MET_SHORT",
        "ElementDataFile": "LOCAL" if local else path.stem + ".raw",
    }  # fmt: skip
    header = "".join(f"{key} = {value}\n" for key, value in fields.items() if key != drop).encode()
    path.write_bytes(header + (data if local else b""))
    if not local:
        path.with_suffix(".raw").write_bytes(data)
    return path


def nhdr(path, volume):
    columns = " ".join(
        "(" + ",".join(f"{x:.12g}" for x in column) + ")" for column in volume.affine[:3, :3].T
    )
    origin = ",".join(f"{x:.12g}" for x in volume.affine[:3, 3])
    path.write_text(
        f"NRRD0004\ntype: short\ndimension: 3\nspace: left-posterior-superior\n"
        f"sizes: {' '.join(map(str, volume.shape))}\nspace directions: {columns}\n"
        f"kinds: domain domain domain\nendian: little\nencoding: raw\n"
        f"space origin: ({origin})\ndata file: {path.stem}.raw\n"
    )
    path.with_suffix(".raw").write_bytes(volume.values.astype("<i2").tobytes(order="F"))
    return path


def same(found, truth):
    assert found.values.dtype == np.uint8
    np.testing.assert_array_equal(found.values, truth.values)
    np.testing.assert_allclose(found.affine, truth.affine, atol=1e-4)


NUMBERS = {1: 7101, 2: 8151, 3: 9, 4: 5}
TABLE = {"7101": "soft tissue", "8151": "bone", "9": "marker", "5": "fat"}
WRITERS = {"a.nii.gz": nifti, "a.mha": metaimage, "a.mhd": metaimage, "a.nhdr": nhdr}


@pytest.mark.parametrize("name", WRITERS)
def test_a_table_of_numbers_makes_any_format_ours(truth, tmp_path, name):
    path = WRITERS[name](tmp_path / name, renumbered(truth, NUMBERS))
    found = read_label_map([LabelSource(path, names=TABLE)])
    same(found.volume, truth)
    assert found.up_to_skin
    assert f"{name}: taken for bone: 8151" in found.lines


@pytest.mark.parametrize(
    ("numbers", "doubt"),
    [
        ({1: 2, 4: 2, 20: 1, 30: 1}, "bone .2. would lie outside"),
        ({1: 3, 20: 1, 30: 2}, "marker .3. would have"),
        ({1: 1, 20: 2, 30: 3}, "markers .3. would lie within the limb"),
        ({1: 1, 4: 2, 20: 3, 30: 3}, "soft tissue .* within the bone"),
        ({1: 4, 4: 1, 20: 2, 30: 2}, "fat .4. would lie .* deep"),
    ],
    ids=["bone-flesh", "tibia-fibula-flesh", "flesh-tibia-fibula", "muscle-fat-bone", "fat-bone-muscle"],
)
def test_numbers_from_1_of_another_program_are_not_taken_for_ours(truth, tmp_path, numbers, doubt):
    both = two_bones(truth.with_values(truth.values[:, :, :6]))  # 3 cm3 of fibula: as small as a marker
    limb = ndimage.binary_fill_holes(both.values > 0)
    depth = ndimage.distance_transform_edt(limb, sampling=both.spacing)
    both = both.with_values(np.where((both.values == 1) & (depth > 2) & (depth < 7), 4, both.values))
    path = nifti(tmp_path / "a.nii", renumbered(both, numbers))
    with pytest.raises(CaseError, match=doubt) as caught:
        read_label_file(path)
    assert '1 = "..."' in caught.value.fix
    words = {1: "soft tissue", 4: "fat", 20: "bone", 30: "bone"}
    stated = {str(number): words[ours] for ours, number in reversed(numbers.items())}
    assert read_label_map([LabelSource(path, names=stated)]).volume.values.any()


def test_an_empty_label_map_is_refused(truth, tmp_path):
    with pytest.raises(CaseError, match="the label map is empty"):
        read_label_file(nifti(tmp_path / "a.nii", renumbered(truth, {})))


def test_ignored_numbers_are_outside(truth, tmp_path):
    path = nifti(tmp_path / "a.nii", renumbered(truth, NUMBERS))
    found = read_label_map([LabelSource(path, names={**TABLE, "9": "ignore"})])
    same(found.volume, truth.with_values(np.where(truth.values == 3, 0, truth.values)))
    assert any("taken for ignored: 9" in line for line in found.lines)


def test_numbers_that_nothing_explains_are_listed_once_with_what_to_write(truth, tmp_path):
    path = nifti(tmp_path / "a.nii", renumbered(truth, {1: 5, 2: 8151, 3: 9}))
    with pytest.raises(CaseError) as caught:
        read_label_map([LabelSource(path, names={"7101": "skin", "8151": "bone"})])
    assert "value(s) 5, 9" in caught.value.what
    assert '5 = "ignore", 9 = "ignore"' in caught.value.fix
    assert "8151" not in str(caught.value)


def test_a_preset_that_knows_all_numbers_is_proposed(truth, tmp_path):
    path = nifti(tmp_path / "a.nii", renumbered(truth, {1: 8131, 2: 8151}))
    with pytest.raises(CaseError) as caught:
        read_label_file(path)
    assert "'musclemap-1' or 'musclemap-2'" in caught.value.fix


def test_a_word_that_is_no_tissue_is_refused(truth, tmp_path):
    path = nifti(tmp_path / "a.nii", renumbered(truth, NUMBERS))
    with pytest.raises(CaseError, match="8151 = 'boen'"):
        read_label_map([LabelSource(path, names={**TABLE, "8151": "boen"})])


PRESET_NUMBERS = {
    "musclemap-1": {1: 8131, 20: 8152, 30: 8162}, "musclemap-2": {1: 8151, 20: 8161, 30: 8171},
    "nnunet-mri-leg-muscles": {1: 6, 20: 13, 30: 14},
    "bartbols/nnUNet_MRI_leg_muscles": {1: 10, 20: 13, 30: 14},
    "MuscleMap": {1: 8222, 20: 8161, 30: 8171},
}  # fmt: skip


@pytest.mark.parametrize("preset", PRESET_NUMBERS)
def test_a_preset_tells_muscles_from_bones_which_keep_their_names(truth, tmp_path, preset):
    path = nifti(tmp_path / "a.nii.gz", renumbered(two_bones(truth), PRESET_NUMBERS[preset]))
    found = read_label_map([LabelSource(path, preset)])
    same(found.volume, truth.with_values(np.where(truth.values == 3, 0, truth.values)))
    assert not found.up_to_skin
    segmented = segmentation_from(found.volume, bone_of=found.bone_of, bone_names=found.bone_names)
    assert segmented.bone_names == ("tibia", "fibula")


def test_numbers_whose_meaning_depends_on_the_version_are_refused(truth, tmp_path):
    path = nifti(tmp_path / "a.nii", renumbered(truth, {1: 8131, 2: 8151, 4: 3}))
    with pytest.raises(CaseError, match="versions of musclemap") as caught:
        read_label_map([LabelSource(path, "musclemap", {"3": "fat"})])
    assert "musclemap-1 or musclemap-2" in caught.value.fix


def test_an_unknown_preset_is_refused_with_those_there_are(truth, tmp_path):
    path = nifti(tmp_path / "a.nii", renumbered(truth, NUMBERS))
    with pytest.raises(CaseError, match="'musclemop'") as caught:
        read_label_map([LabelSource(path, "musclemop")])
    assert all(each in caught.value.fix for each in PRESETS)


@pytest.mark.parametrize(
    ("preset", "number", "words"),
    [("total", 75, "bone (femur)"), ("total", 5, "ignored"), ("total", 80, "soft tissue"),
     ("total_mr", 36, "bone (femur)"), ("appendicular_bones", 1, "bone (patella)"),
     ("appendicular_bones_mr", 4, "bone"), ("tissue_types_mr", 1, "fat"), ("tissue_types", 3, "soft tissue"),
     ("tissue_4_types", 4, "fat"), ("musclemap-2", 1101, "soft tissue"), ("musclemap-2", 6151, "bone")],
)  # fmt: skip
def test_numbers_mean_what_their_program_says(preset, number, words):
    assert preset_of(preset, [number])[number][1].words == words


def test_names_in_the_header_of_a_nifti_are_used(truth, tmp_path):
    """As TotalSegmentator writes them with `--ml`."""
    numbers = {1: 3, 20: 2, 30: 1, 3: 4}
    names = {1: "fibula", 2: "tibia", 3: "skin_and_muscle", 4: "markers", 5: "liver", 6: "Segment_9"}
    path = nifti(tmp_path / "a.nii.gz", renumbered(two_bones(truth), numbers), names=names)
    found = read_label_map([LabelSource(path)])
    same(found.volume, truth)
    assert found.bone_names == ("fibula", "tibia")
    assert "a.nii.gz: taken for bone (tibia): 2 tibia" in label_lines(LabelSource(path))


def test_a_file_of_names_beside_a_nifti_of_labels_is_used(truth, tmp_path):
    path = nifti(tmp_path / "a.nii", renumbered(truth, NUMBERS), intent="label", aux="names.txt")
    rows = [
        "# made for a test",
        '7101 255 0 0 1 1 1 "Soft tissue"',
        '8151 0 255 0 1 1 1 "Bones"',
        "9 marker 0 0 255 0",
    ]
    (tmp_path / "names.txt").write_text("\n".join(rows))
    same(read_label_file(path), truth)


TABLES = {
    "snap.txt": '# ITK-SnAP\n 0 0 0 0 0 0 0 "Clear"\n 7101 255 0 0 1 1 1 "Flesh"\n 8151 0 9 0 1 1 1 "Tibia"\n'
    ' 9 0 9 0 1 1 1 "Marker"\n',
    "dseg.tsv": "index\tname\tabbreviation\n7101\tFlesh\tSAT\n8151\tTibia\tT\n9\tMarker\tM\n",
    "colours.csv": "LabelValue,Name,Color_R\n7101,Flesh,9\n8151,Tibia,9\n9,Marker,7\n",
    "dataset.json": '{"labels": {"background": 0, "Flesh": 7101, "Tibia": 8151, "Marker": 9}}',
    "old.json": '{"labels": {"0": "background", "7101": "Flesh", "8151": "Tibia", "9": "Marker"}}',
}


@pytest.mark.parametrize("table", TABLES)
def test_numbers_are_named_by_a_file_of_the_case(truth, tmp_path, table):
    nifti(tmp_path / "a.nii", renumbered(truth, NUMBERS), names={7101: "Bone", 8151: "Flesh"})
    (tmp_path / table).write_text(TABLES[table])
    reading = CaseReading(tmp_path)
    sources = read_label_sources({"file": "a.nii", "names": table, "9": "ignore"}, reading)
    assert not reading.problems
    found = read_label_map(sources)
    same(found.volume, truth.with_values(np.where(truth.values == 3, 0, truth.values)))
    assert found.bone_names == ("tibia",)


@pytest.mark.parametrize(
    ("name", "content", "what"),
    [
        ("a.json", b'{"labels": [1, 2]}', "names no number"),
        ("a.json", b"{", "names no number .*JSON|Expecting"),
        ("a.txt", b"\x1f\x8b7 \xff", "names no number .*codec"),
        ("b.txt", None, "not found"),
    ],
)
def test_a_file_that_names_nothing_is_a_problem_of_the_case(tmp_path, name, content, what):
    (tmp_path / "a.nii").touch()
    if content is not None:
        (tmp_path / name).write_bytes(content)
    reading = CaseReading(tmp_path)
    read_label_sources({"file": "a.nii", "names": name}, reading)
    (problem,) = reading.problems
    assert re.search(what, problem.what)


def test_a_preset_that_contradicts_the_names_is_refused_unless_the_table_decides(truth, tmp_path):
    names = {1: "patella", 2: "tibia", 3: "soft tissue"}
    path = nifti(tmp_path / "a.nii", renumbered(truth, {1: 3, 2: 2}), names=names)
    with pytest.raises(
        CaseError, match="calls 3 'soft tissue', but the preset appendicular_bones calls it 'fibula'"
    ):
        read_label_map([LabelSource(path, "appendicular_bones")])
    found = read_label_map([LabelSource(path, "appendicular_bones", {"3": "soft tissue"})])
    same(found.volume, truth.with_values(np.where(truth.values == 3, 0, truth.values)))


def masks(folder, truth, **names):
    folder.mkdir()
    for name, value in names.items():
        nifti(folder / f"{name}.nii.gz", truth.with_values((truth.values == value).astype(np.uint8)))
    return folder


def test_a_folder_with_a_file_for_each_segment_is_one_label_map(truth, tmp_path):
    both = two_bones(truth)
    folder = masks(tmp_path / "seg", both, tibia=20, fibula=30, Skin=1, marker_1=3, spleen=99, thing=98)
    (folder / "statistics.json").write_text("{}")
    found = read_label_map([LabelSource(folder)])
    same(found.volume, truth)
    assert set(found.bone_names) == {"tibia", "fibula"}
    assert not any("thing" in line for line in found.lines)


def test_files_of_a_folder_whose_names_say_nothing_are_listed_once(truth, tmp_path):
    folder = masks(tmp_path / "seg", truth, bone=2, Segment_1=1, Segment_3=3)
    with pytest.raises(CaseError) as caught:
        read_label_map([LabelSource(folder)])
    assert '"Segment_1" = "ignore", "Segment_3" = "ignore"' in caught.value.fix
    table = {"Segment_1": "soft tissue", "segment_3": "marker"}
    same(read_label_map([LabelSource(folder, names=table)]).volume, truth)


def test_a_file_with_several_values_in_a_folder_of_masks_is_refused(truth, tmp_path):
    folder = masks(tmp_path / "seg", truth, bone=2)
    nifti(folder / "skin.nii", truth)
    with pytest.raises(CaseError, match=r"skin.nii has several values"):
        read_label_map([LabelSource(folder)])


def test_a_folder_without_label_maps_is_refused(tmp_path):
    (tmp_path / "a.txt").write_text("x")
    with pytest.raises(CaseError, match="the folder contains no label map"):
        read_label_file(tmp_path)


def test_several_maps_on_one_grid_are_one(truth, tmp_path):
    bones = nifti(
        tmp_path / "bones.nii", truth.with_values(np.where(truth.values == 2, 2, 0).astype(np.uint8))
    )
    tissue = nifti(tmp_path / "tissue.nii", renumbered(truth, {1: 7, 2: 7, 3: 9}))
    sources = [
        LabelSource(bones, "appendicular_bones"),
        LabelSource(tissue, None, {"7": "skin", "9": "marker"}),
    ]
    found = read_label_map(sources)
    same(found.volume, truth)
    assert found.bone_names == ("tibia",)


def test_maps_on_other_grids_are_refused(truth, tmp_path):
    moved = truth.affine.copy()
    moved[:3, 3] += 3.0
    sources = [
        LabelSource(nifti(tmp_path / "a.nii", truth)),
        LabelSource(nifti(tmp_path / "b.nii", Volume(truth.values, moved))),
    ]
    with pytest.raises(CaseError, match="different grids"):
        read_label_map(sources)


def test_bones_without_flesh_need_an_image(truth, tmp_path):
    path = nifti(tmp_path / "a.nii", truth.with_values(np.where(truth.values == 2, 2, 0).astype(np.uint8)))
    with pytest.raises(CaseError, match="soft tissue") as caught:
        read_label_map([LabelSource(path, "appendicular_bones")])
    assert "mri" in caught.value.fix
    assert not read_label_map([LabelSource(path, "appendicular_bones")], is_whole=False).up_to_skin


def test_bones_that_touch_are_kept_apart_by_their_names(truth, tmp_path):
    values = two_bones(truth).values.copy()
    tibia, fibula = (np.argwhere(values == n).mean(axis=0) for n in (20, 30))
    for t in np.linspace(0, 1, 60):  # a bridge of the tibia's
        i, j, k = np.floor(tibia + t * (fibula - tibia)).astype(int)
        here = values[i : i + 2, j : j + 2, k]
        here[here != 30] = 20
    path = nifti(tmp_path / "a.nii", truth.with_values(values))
    table = {"1": "soft tissue", "3": "marker"}
    apart = read_label_map([LabelSource(path, names={**table, "20": "tibia", "30": "fibula"})])
    found = segmentation_from(apart.volume, bone_of=apart.bone_of, bone_names=apart.bone_names)
    assert found.bone_names == ("tibia", "fibula")
    together = read_label_map([LabelSource(path, names={**table, "20": "bone", "30": "bone"})])
    assert len(segmentation_from(together.volume, bone_of=together.bone_of).bones) == 1


def test_an_image_given_as_label_map_is_refused(truth, tmp_path, rng):
    noise = truth.with_values(rng.integers(0, 4000, truth.shape).astype(np.int16))
    with pytest.raises(CaseError, match="different values: it is an image"):
        read_label_file(nifti(tmp_path / "a.nii", noise))
    halves = truth.with_values(truth.values.astype(np.float32) / 2)
    with pytest.raises(CaseError, match=r"value\(s\) 0.5"):
        read_label_file(nifti(tmp_path / "b.nii", halves))


@pytest.mark.parametrize("name", ["a.mha", "a.mhd"])
@pytest.mark.parametrize("is_compressed", [False, True])
def test_a_metaimage_is_read_in_place(truth, tmp_path, name, is_compressed):
    found = read_metaimage(metaimage(tmp_path / name, truth, is_compressed=is_compressed))
    np.testing.assert_array_equal(found.values, truth.values)
    np.testing.assert_allclose(found.affine, truth.affine, atol=1e-6)


@pytest.mark.parametrize(
    "drop", ["TransformMatrix", "DimSize", "ElementType", "ElementDataFile", "ElementSpacing"]
)
def test_a_metaimage_that_lacks_what_is_needed_is_refused(truth, tmp_path, drop):
    with pytest.raises(CaseError, match=r"cannot be read|does not define its orientation"):
        read_metaimage(metaimage(tmp_path / "a.mha", truth, drop=drop))


@pytest.mark.parametrize("writer", [metaimage, nhdr])
def test_data_beside_a_header_belong_to_it(truth, tmp_path, writer):
    path = writer(tmp_path / ("a.mhd" if writer is metaimage else "a.nhdr"), truth)
    before = sha256(path)
    data = tmp_path / "a.raw"
    data.write_bytes(bytes(reversed(data.read_bytes())))
    assert sha256(path) != before
    data.write_bytes(data.read_bytes()[:100])
    with pytest.raises(CaseError, match="cannot be read"):
        read_label_file(path)
    data.unlink()
    with pytest.raises(CaseError, match="not beside it"):
        read_label_file(path)


def test_a_header_does_not_read_what_lies_elsewhere(truth, tmp_path):
    (tmp_path / "case").mkdir()
    path = nhdr(tmp_path / "case" / "a.nhdr", truth)
    (tmp_path / "case" / "a.raw").rename(tmp_path / "secret.raw")
    path.write_text(path.read_text().replace("data file: a.raw", "data file: ../secret.raw"))
    with pytest.raises(CaseError, match="not beside it"):
        read_label_file(path)


MUSCLES = (
    "gluteus_maximus_left", "thigh_medial_compartment_left", "Left Levator Scapulae", "flexor carpi radialis",
    "iliotibial tract", "Achilles tendon", "Peroneus brevis/longus", "Left Rectus Femoris",
)  # fmt: skip


@pytest.mark.parametrize("name", MUSCLES)
def test_muscles_named_after_bones_are_soft_tissue(name):
    assert meaning_of(name).words == "soft tissue"
    assert not meaning_of(name).up_to_skin


@pytest.mark.parametrize(
    "name", ["hip_left", "tarsal", "phalanges_feet", "vertebrae_L5", "rib_left_1", "Ilium"]
)
def test_other_bones_are_bone_without_a_name_of_their_own(name):
    assert meaning_of(name).words == "bone"


def test_every_number_of_every_preset_has_the_kind_that_its_table_says():
    from limbcli.imaging.label_names import _rows

    for row in _rows():
        words = preset_of(row["preset"], [int(row["number"])])[int(row["number"])][1].words
        kind = {"muscle": "soft tissue", "limb": "soft tissue", "ignore": "ignored"}.get(
            row["kind"], row["kind"]
        )
        assert words.split(" (")[0] == kind, row
