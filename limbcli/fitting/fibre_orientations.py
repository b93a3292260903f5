"""fit with fibres: orientation of the images to the fibres, and what the measured orientations determine."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from limbcli.effects.tissue import fibre_direction
from limbcli.meshing.fibres_from_angles import mean_axis
from limbcli.model import ElementMap, LimbModel
from limbcli.results import StageWriter

_ALIKE = 0.25  # difference of shares along fibres below which two images have the same orientation
_ACROSS, _ALONG = 0.25, 0.75


def share_along(model: LimbModel) -> float:
    """Share of the fibres' shear stiffness in the image's wave speed: f_x^2 + f_z^2 (0 across, 1 along)."""
    direction = fibre_direction(model)
    axes = direction.values if isinstance(direction, ElementMap) else np.array([direction], dtype=float)
    axis, _ = mean_axis(axes)
    return float(axis[0] ** 2 + axis[2] ** 2)


def write_orientations(
    models: Sequence[tuple[str, LimbModel]], has_speeds: Sequence[bool], writer: StageWriter
) -> None:
    """Write `orientations` of fit-joint.json, and warnings about what they cannot determine.

    models : site name and model; has_speeds : for each site, whether speeds were read
    """
    shares = {name: share_along(model) for name, model in models}
    writer.data["orientations"] = {
        name: {
            "fibre_to_image_deg": float(np.degrees(np.arccos(min(1.0, np.sqrt(share))))),
            "share_along": share,
            "fibres_told": model.fibres is not None,
            "has_speeds": seen,
        }
        for (name, model), share, seen in zip(models, shares.values(), has_speeds, strict=True)
    }
    listed = ", ".join(f"{name} {np.degrees(np.arccos(np.sqrt(s))):.0f} deg" for name, s in shares.items())
    writer.summary.append(f"fibres to the image plane: {listed}")
    for name, model in models:
        if model.fibres is None:
            writer.warnings.append(
                f"no fibre direction is given for site {name}: along the limb, within the skin, is assumed"
            )
    writer.warnings.extend(undetermined(list(shares.values()), has_speeds))


def undetermined(shares: Sequence[float], has_speeds: Sequence[bool]) -> list[str]:
    """Sentences on what measurements in these orientations cannot determine.

    >>> undetermined([0.0, 1.0], [True, True])
    []
    >>> print(undetermined([0.0], [True])[0][:59])
    all records are across the fibres: their speeds determine c
    """
    seen = [share for share, speeds in zip(shares, has_speeds, strict=True) if speeds]
    if max(shares) - min(shares) >= _ALIKE:
        if len(seen) < 2 or max(seen) - min(seen) < _ALIKE:
            return [
                "shear-wave speeds were read in one orientation only: fibre_shear is determined by "
                "forces; also read the speeds in the other orientation"
            ]
        return []
    share = float(np.mean(shares))
    turn = "also measure with the probe turned by 90 degrees"
    if share < _ACROSS:
        return [
            "all records are across the fibres: their speeds determine c, but the extra stiffness "
            f"along the fibres is determined by the force alone, where m and the mesh have the same effect; "
            f"{turn}"
        ]
    if share > _ALONG:
        return [
            "all records are along the fibres: their speeds determine only the product c (1 + fibre_shear); "
            f"a softer c with stiffer fibres fits equally well; {turn}"
        ]
    return [
        f"all records are of one orientation: only a combination of c and fibre_shear is determined; {turn}"
    ]


def write_moduli(c_kpa: float, fibre_shear: float, writer: StageWriter) -> list[str]:
    """Write the shear moduli along and across the fibres, as reported in elastography; a line on them."""
    across = c_kpa / 2
    along = across * (1 + fibre_shear)
    writer.data["mu_across_kpa"], writer.data["mu_along_kpa"] = across, along
    return [f"shear modulus across the fibres {across:.2f} kPa, along them {along:.2f} kPa"]
