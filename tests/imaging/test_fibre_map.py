"""Fibre maps: axes without a sign, in the right frame, interpolated as such; others are refused in words."""

from __future__ import annotations

from pathlib import Path

import nibabel as nib
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from limbcli.errors import CaseError
from limbcli.imaging.fibre_map import REACH, read_fibre_map

AFFINE = np.array([[-2.0, 0, 0, 30], [0, 0, 2.0, -20], [0, 2.0, 0, -40], [0, 0, 0, 1]])  # RAS, oblique axes
SHAPE = (20, 24, 18)
LPS_FROM_RAS = np.diag([-1.0, -1.0, 1.0])


def field(points: np.ndarray) -> np.ndarray:
    """Unit axes in LPS that turn slowly along z."""
    angle = np.radians(20.0) + 0.01 * points[..., 2]
    return np.stack([np.sin(angle), 0.2 * np.ones_like(angle), np.cos(angle)], axis=-1) / np.sqrt(1.04)


def voxels() -> np.ndarray:
    """(n_i, n_j, n_k, 3) LPS of every voxel."""
    index = np.stack(np.meshgrid(*(np.arange(n) for n in SHAPE), indexing="ij"), axis=-1)
    return (index @ AFFINE[:3, :3].T + AFFINE[:3, 3]) @ LPS_FROM_RAS


def write(path: Path, values: np.ndarray, *, affine: np.ndarray = AFFINE, code: int = 1) -> Path:
    image = nib.Nifti1Image(values.astype(np.float32), affine)
    image.header.set_xyzt_units("mm")
    image.set_sform(affine, code)
    image.set_qform(affine, code)
    nib.save(image, path)
    return path


def middle(n: int = 200) -> np.ndarray:
    rng = np.random.default_rng(7)
    index = 2 + rng.random((n, 3)) * (np.array(SHAPE) - 5)
    return (index @ AFFINE[:3, :3].T + AFFINE[:3, 3]) @ LPS_FROM_RAS


def angles_deg(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.degrees(np.arccos(np.clip(np.abs((a * b).sum(axis=1)), 0, 1)))


@pytest.mark.parametrize("frame", ["ras", "lps", "fsl"])
def test_axes_are_those_of_the_field_in_each_frame(tmp_path: Path, frame):
    """Signs and lengths are drawn anew in every voxel: they mean nothing."""
    rng = np.random.default_rng(7)
    stored = field(voxels())
    if frame != "lps":
        stored = stored @ LPS_FROM_RAS
    if frame == "fsl":
        axes = AFFINE[:3, :3] / 2.0
        flip = np.diag([-1.0 if np.linalg.det(axes) > 0 else 1.0, 1.0, 1.0])
        stored = stored @ axes @ flip
    stored = stored * rng.choice([-1.0, 1.0], SHAPE)[..., None] * rng.uniform(0.2, 1.0, SHAPE)[..., None]
    found = read_fibre_map(write(tmp_path / "v1.nii.gz", stored), frame=frame).at(middle())
    assert angles_deg(found.axes, field(middle())).max() < 0.1
    assert found.covered.all()
    assert found.agreement.min() > 0.99


def test_another_frame_gives_other_axes(tmp_path: Path):
    """So the key matters: read as LPS what is RAS, the field is off by tens of degrees."""
    path = write(tmp_path / "v1.nii", field(voxels()) @ LPS_FROM_RAS)
    assert angles_deg(read_fibre_map(path, frame="lps").at(middle()).axes, field(middle())).min() > 5.0


def test_opposite_neighbours_are_one_axis_and_crossing_ones_agree_less(tmp_path: Path):
    stored = np.zeros((*SHAPE, 3))
    stored[..., 2] = 1.0
    stored[::2, ..., 2] = -1.0
    sample = read_fibre_map(write(tmp_path / "a.nii", stored)).at(middle())
    np.testing.assert_allclose(np.abs(sample.axes[:, 2]), 1.0, atol=1e-6)
    rng = np.random.default_rng(7)
    anyhow = Rotation.random(np.prod(SHAPE), random_state=rng).apply([0.0, 0.0, 1.0]).reshape(*SHAPE, 3)
    assert read_fibre_map(write(tmp_path / "b.nii", anyhow)).at(middle()).agreement.mean() < 0.6


def test_beyond_the_muscle_the_nearest_direction_is_taken_a_little_way(tmp_path: Path):
    stored = field(voxels()) @ LPS_FROM_RAS
    stored[8:] = 0.0  # 2 mm a voxel: the last direction is at index 7
    fibres = read_fibre_map(write(tmp_path / "v1.nii", stored))
    index = np.array([[9.0, 10, 9], [7 + 0.5 * REACH + 1, 10, 9], [-30.0, 10, 9]])
    points = (index @ AFFINE[:3, :3].T + AFFINE[:3, 3]) @ LPS_FROM_RAS
    sample = fibres.at(points)
    assert list(sample.near) == [True, False, False]
    assert not sample.covered.any()
    assert angles_deg(sample.axes[:1], field(points[:1])).max() < 1.0
    assert np.isnan(sample.axes[1:]).all()


@pytest.mark.parametrize(
    ("shape", "message"),
    [
        ((*SHAPE, 4), "4 components, not 3"),
        ((*SHAPE, 6), r"6 components, not 3 \(the tensor itself"),
        (SHAPE, "1 component, not 3"),
        ((*SHAPE, 2, 3), "6 components"),
    ],
)
def test_another_number_of_components_is_refused(tmp_path: Path, shape, message):
    with pytest.raises(CaseError, match=message) as caught:
        read_fibre_map(write(tmp_path / "v1.nii", np.ones(shape)))
    assert "V1" in caught.value.fix


def test_a_fifth_dimension_of_three_is_read(tmp_path: Path):
    stored = (field(voxels()) @ LPS_FROM_RAS)[:, :, :, None, :]
    assert read_fibre_map(write(tmp_path / "v1.nii", stored)).at(middle()).covered.all()


@pytest.mark.parametrize(
    ("code", "message"),
    [(0, "does not define its orientation"), (3, "Talairach"), (4, "another frame: MNI space")],
)
def test_a_map_of_another_frame_is_refused(tmp_path: Path, code, message):
    with pytest.raises(CaseError, match=message):
        read_fibre_map(write(tmp_path / "v1.nii", np.ones((*SHAPE, 3)), code=code))


def test_no_direction_at_all_and_no_numbers_are_refused(tmp_path: Path):
    with pytest.raises(CaseError, match="every direction of the fibre map has length 0"):
        read_fibre_map(write(tmp_path / "v1.nii", np.zeros((*SHAPE, 3))))
    (tmp_path / "v2.nii").write_bytes(b"no image")
    with pytest.raises(CaseError, match="cannot be read"):
        read_fibre_map(tmp_path / "v2.nii")
    path = write(tmp_path / "v3.nii", np.ones((*SHAPE, 3)))
    path.write_bytes(path.read_bytes()[:900])
    with pytest.raises(CaseError, match="cannot be read"):
        read_fibre_map(path)


def test_values_that_are_no_numbers_are_no_directions(tmp_path: Path):
    stored = field(voxels()) @ LPS_FROM_RAS
    stored[5, 5, 5] = np.nan
    assert read_fibre_map(write(tmp_path / "v1.nii", stored)).grid.values[5, 5, 5] == 0
