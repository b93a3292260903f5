"""fit with fibres: what the images' orientations determine, and the effect of an uncertain direction."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from limbcli.case import Site
from limbcli.effects.tissue import fibre_direction
from limbcli.errors import SolveError
from limbcli.fitting.force_curves import LawCurve
from limbcli.meshing.fibres_from_angles import mean_axis
from limbcli.model import Array, ElementMap, LimbModel, Value
from limbcli.results import StageWriter, data_if_there

_MATTERS = 0.05  # relative change of force or speed above which a warning is given
_LEAST_IN_SKIN = 1e-6


def stated_deviation(out: Path, site: Site) -> float | None:
    """Standard deviation of the site's fibre direction (deg), from the result of `mesh`; None if unknown."""
    fibres = data_if_there(out, "mesh", site=site.name).get("fibres") or {}
    value = fibres.get("deviation_deg")
    return None if value is None else float(value)


def turned(direction: Value, angle_deg: float) -> Value:
    """Rotate fibres towards the skin's normal by an angle, in the plane of fibre and normal.

    >>> np.round(turned((0.0, 1.0, 0.0), 30.0), 3)
    array([0.   , 0.866, 0.5  ])
    """
    axes = np.atleast_2d(direction.values if isinstance(direction, ElementMap) else np.asarray(direction))
    about = np.cross(axes, [0.0, 0.0, 1.0])
    size = np.linalg.norm(about, axis=1, keepdims=True)
    about = np.where(size > _LEAST_IN_SKIN, about / np.maximum(size, _LEAST_IN_SKIN), [1.0, 0.0, 0.0])
    moved = Rotation.from_rotvec(np.radians(angle_deg) * about).apply(axes)
    if isinstance(direction, ElementMap):
        return ElementMap(f"{direction.name}_turned", direction.block, moved)
    return float(moved[0, 0]), float(moved[0, 1]), float(moved[0, 2])


def write_direction_uncertainty(
    curve_along: Callable[[Value], LawCurve], direction: Value, shape: Array, deviation_deg: float,
    writer: StageWriter, *, site: str,
) -> None:  # fmt: skip
    """Write `direction_uncertainty` of fit-joint.json: change of force and speed by fibres turned by one
    standard deviation.

    curve_along : the site's curve with its fibres in a direction; `direction`, `shape` : of the fit
    """
    values = []
    for angle in (0.0, deviation_deg):
        curve = curve_along(turned(direction, angle))
        try:
            values.append(curve(shape).values)
        except SolveError as error:
            writer.warnings.append(f"{site}: fibres {angle:.1f} deg off were not tried: {error.what}")
            return
        finally:
            curve.close()
    force, speed = np.split(values[1] / values[0] - 1.0, 2)
    worst = {"force_change_fraction": float(force[np.abs(force).argmax()]),
             "speed_change_fraction": float(speed[np.abs(speed).argmax()])}  # fmt: skip
    writer.data.setdefault("direction_uncertainty", {})[site] = {"deviation_deg": deviation_deg, **worst}
    by_force, by_speed = (100 * each for each in worst.values())
    writer.summary.append(
        f"{site}: fibres {deviation_deg:.1f} deg further out of the skin change the force by up to "
        f"{by_force:+.1f} %, speeds by {by_speed:+.1f} %"
    )
    if max(map(abs, worst.values())) > _MATTERS:
        writer.warnings.append(
            f"{site}: the fibres' direction is uncertain by {deviation_deg:.1f} deg, which matters here "
            "(direction_uncertainty) and is not included in the intervals; measure it more precisely, or in "
            "a second image"
        )


_ALIKE = 0.25  # difference of shares along fibres below which two images have the same orientation
_ACROSS, _ALONG = 0.25, 0.75


def share_along(model: LimbModel) -> float:
    """Share of the fibres' shear stiffness in the image's wave speed: f_x^2 + f_z^2 (0 across, 1 along)."""
    axis = mean_fibre(model)
    return float(axis[0] ** 2 + axis[2] ** 2)


def mean_fibre(model: LimbModel) -> Array:
    """The fibres' mean axis (3,), a unit vector."""
    direction = fibre_direction(model)
    axes = direction.values if isinstance(direction, ElementMap) else np.array([direction], dtype=float)
    return mean_axis(axes)[0]


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
