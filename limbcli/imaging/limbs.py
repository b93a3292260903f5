"""Isolate one limb of an image, and check its contrast."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from limbcli.errors import CaseError
from limbcli.imaging.intensity import otsu
from limbcli.imaging.signed_distance import depth_inside, distance_to, filled_by_slice
from limbcli.imaging.skin_segmentation import background_threshold
from limbcli.imaging.volume import Volume

Side = Literal["left", "right"]

_SECOND = 0.35  # fraction of the largest component: a second one larger than this is a second limb
_AROUND = 6.0  # mm around the other limb that are removed with it


def upright(volume: Volume) -> tuple[Volume, tuple[str, ...]]:
    """The image with dark air; an image with bright air is inverted, with a note."""
    values = volume.values
    rim = np.concatenate([values[0].ravel(), values[-1].ravel(), values[:, 0].ravel(), values[:, -1].ravel()])
    split = otsu(values[::2, ::2, ::2].ravel())
    if np.median(rim) <= split:
        return volume, ()
    note = "the air is bright: the image's contrast was inverted"
    return volume.with_values(values.max() - values), (note,)


def one_limb(volume: Volume, side: Side | None, *, threshold: float | None = None) -> Volume:
    """The image with only one limb left in it (k along the limb).

    side : "left" or "right" of the patient; required if two limbs are in view

    Raises CaseError for two limbs in view and no side given, or more than two limbs.
    """
    level = background_threshold(volume.values) if threshold is None else threshold
    sigma = 1.0 / volume.spacing
    sigma[2] = 0.0
    bright = ndimage.gaussian_filter(volume.values.astype(np.float32), sigma) > level
    parts, n_parts = ndimage.label(filled_by_slice(bright))  # what is enclosed by a limb is not a second limb
    if n_parts < 2:
        return volume
    sizes = np.bincount(parts.ravel())[1:]
    limbs = np.flatnonzero(sizes > _SECOND * sizes.max()) + 1
    if len(limbs) < 2:
        return volume
    centres = np.array(ndimage.center_of_mass(parts > 0, parts, limbs))
    to_the_left = volume.to_patient(centres)[:, 0]
    if side is None or len(limbs) > 2:
        places = ", ".join(f"{x:.0f}" for x in np.sort(to_the_left))
        raise CaseError(
            f"{len(limbs)} limbs are in view, at x = {places} mm",
            where="MRI series",
            fix="state which one: limbcli segment CASE --limb left (or right)"
            if len(limbs) == 2
            else "crop the series to one limb, or use a label map ([imaging] labels)",
            n_limbs=len(limbs),
        )
    order = np.argsort(to_the_left)  # LPS: x increases towards the patient's left
    other, wanted = limbs[order if side == "left" else order[::-1]]
    return volume.with_values(_without(volume, parts, int(wanted), int(other)))


def _without(volume: Volume, parts: NDArray[np.int_], wanted: int, other: int) -> NDArray:
    """Replace the other limb and its surroundings, as far as they are nearer to it, by air."""
    air = float(np.median(volume.values[parts == 0])) if (parts == 0).any() else 0.0
    to_wanted = distance_to(parts == wanted, volume.spacing)
    to_other = distance_to(parts == other, volume.spacing)
    gone = (to_other < to_wanted) & (to_other <= _AROUND)
    values = volume.values.copy()
    values[gone] = air
    return values


def require_bright_fat(volume: Volume, limb: NDArray[np.bool_]) -> None:
    """Refuse an image in which subcutaneous fat is darker than deep tissue: no T1 contrast.

    Raises CaseError with possible fixes.
    """
    depth = np.zeros(limb.shape, np.float32)
    for k in range(limb.shape[2]):
        depth[:, :, k] = depth_inside(limb[:, :, k], volume.spacing[:2])
    shell, core = volume.values[(depth > 2.0) & (depth < 6.0)], volume.values[depth > 12.0]
    if not len(shell) or not len(core):
        return
    ratio = float(np.percentile(shell, 75) / max(np.median(core), 1e-9))
    if ratio < 0.95:
        raise CaseError(
            f"fat is darker than muscle (ratio {ratio:.2f}): no T1 contrast, or fat-suppressed",
            where="MRI series (Scan Options 0018,0022; Sequence Name 0018,0024)",
            fix="use a T1 series without fat suppression (for Dixon: in-phase), or [imaging] labels",
            fat_over_muscle=round(ratio, 3),
        )
