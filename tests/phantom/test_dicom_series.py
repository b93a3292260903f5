"""The synthetic MR image and its DICOM files, read back with pydicom alone."""

from __future__ import annotations

import meshio
import nibabel as nib
import numpy as np
import pydicom
import pytest

from limbcli.files.atomic import sha256
from limbcli.imaging.surface import write_surface
from limbcli.phantom import mri, truth
from limbcli.phantom.anatomy import Tissue
from limbcli.phantom.dicom_series import write_series
from limbcli.phantom.subject import make_subject


@pytest.fixture(scope="module")
def subject():
    return make_subject(np.random.default_rng(7), voxel=(2.0, 2.0, 6.0))


@pytest.fixture(scope="module")
def volume(subject):
    fractions = mri.tissue_fractions(subject.anatomy, subject.grid, subject.limb_from_patient)
    return mri.acquire(fractions, subject.grid, rng=np.random.default_rng(7))


def test_fractions_fill_every_voxel_and_hold_the_limbs_volume(subject, volume):
    assert volume.fractions.sum(axis=0) == pytest.approx(1.0, abs=1e-6)
    voxel = subject.grid.spacing.prod()
    surface = truth.surfaces(subject, edge=3.0)["skin"]
    corner = surface.points[surface.faces]
    expected = np.einsum("ij,ij->", corner[:, 0], np.cross(corner[:, 1], corner[:, 2])) / 6
    limb = voxel * (1 - volume.fractions[Tissue.AIR] - volume.fractions[Tissue.MARKER]).sum()
    assert limb == pytest.approx(expected, rel=0.005)


def test_signal_is_that_of_a_t1_image(volume):
    def mean(tissue):
        return volume.signal[volume.fractions[tissue] == 1.0].mean()

    assert mean(Tissue.AIR) == pytest.approx(mri.NOISE * np.sqrt(np.pi / 2), rel=0.02)  # Rayleigh
    assert mean(Tissue.MARROW) > 2 * mean(Tissue.MUSCLE) > 10 * mean(Tissue.AIR)
    assert mean(Tissue.FAT) > 2 * mean(Tissue.MUSCLE)


def test_series_gives_back_signal_and_geometry(tmp_path, subject, volume):
    paths = write_series(tmp_path, volume.signal, subject.grid, seed=7)
    datasets = [pydicom.dcmread(path) for path in paths]
    assert len({each.SOPInstanceUID for each in datasets}) == subject.grid.shape[2]
    assert len({each.SeriesInstanceUID for each in datasets}) == 1
    for k, each in enumerate(datasets):
        slope = float(each.RescaleSlope)
        assert slope != 1.0
        assert each.pixel_array.max() < 4096
        read = slope * each.pixel_array.T
        assert np.abs(read - volume.signal[:, :, k]).max() <= 0.51 * slope
        expected = subject.grid.points(np.array([[0.0, 0.0, k]]))[0]
        assert np.array(each.ImagePositionPatient, float) == pytest.approx(expected, abs=1e-6)
        cosines = np.array(each.ImageOrientationPatient, float).reshape(2, 3)
        assert cosines == pytest.approx(subject.grid.axes[:2], abs=1e-8)


def test_names_alone_do_not_sort_the_slices_upwards(tmp_path, subject, volume):
    paths = write_series(tmp_path, volume.signal, subject.grid)
    assert sorted(paths) == paths[::-1]


def test_the_same_seed_gives_the_same_bytes(tmp_path, subject, volume):
    for name in ("a", "b"):
        write_series(tmp_path / name, volume.signal, subject.grid, seed=3)
        truth.write_labels(tmp_path / name / "labels.nii.gz", volume.labels, subject.grid)
    assert sha256(tmp_path / "a") == sha256(tmp_path / "b")


def test_a_written_surface_reads_back(tmp_path, subject):
    surface = truth.surfaces(subject, edge=6.0)["bone_tibia"]
    write_surface(tmp_path / "tibia.ply", surface)
    read = meshio.read(tmp_path / "tibia.ply")
    assert read.points == pytest.approx(surface.points, abs=1e-4)
    assert np.array_equal(read.cells_dict["triangle"], surface.faces)


def test_label_map_has_the_images_geometry_in_ras(tmp_path, subject, volume):
    truth.write_labels(tmp_path / "labels.nii.gz", volume.labels, subject.grid)
    image = nib.load(tmp_path / "labels.nii.gz")
    assert np.array_equal(np.asarray(image.dataobj), volume.labels)
    ras = image.affine @ [3.0, 4.0, 5.0, 1.0]
    lps = subject.grid.points(np.array([[3.0, 4.0, 5.0]]))[0]
    assert ras[:3] == pytest.approx([-lps[0], -lps[1], lps[2]], abs=1e-3)
    assert sorted(np.unique(volume.labels)) == [0, 1, 2, 3]
