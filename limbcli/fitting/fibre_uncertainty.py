"""Effect of an uncertain fibre direction: solve the fitted model again with the fibres turned."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from limbcli.case import Site
from limbcli.errors import SolveError
from limbcli.fitting.force_curves import LawCurve
from limbcli.model import Array, ElementMap, Value
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
