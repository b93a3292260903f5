"""Figures of a site's geometry that matter for the measurement taken there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from limbcli.meshing.domain import TissueDomain
from limbcli.meshing.mending import Plane
from limbcli.meshing.probe import ProbeShape
from limbcli.model import Array

_DEEPEST = 150.0  # search depth of a beam below the face at first touch, mm
_STEP = 0.25  # mm between the places of that search


@dataclass(frozen=True)
class SiteChecks:
    """Figures of a site's geometry.

    skin_bone_mm : tissue thickness along the beam at the probe's centre; None without bone there
    thinnest_under_probe_mm : smallest such thickness under the face; None without bone there
    over_tissue_share : fraction of the face with skin below it
    bone_share : fraction of the face with bone in the beam
    to_cut_mm : distance from the face's outline to the nearest cut; None without cuts
    gap_at_first_touch_mm : largest height of the face above the skin at first touch; NaN without skin
    """

    skin_bone_mm: float | None
    thinnest_under_probe_mm: float | None
    over_tissue_share: float
    bone_share: float
    to_cut_mm: float | None
    gap_at_first_touch_mm: float


def site_checks(domain: TissueDomain, probe: ProbeShape) -> SiteChecks:
    """Measure the domain along the probe's beam (-z) over its face."""
    x, y = probe.plan(2.0)
    covered = np.isfinite(probe.rise(x, y))
    x, y = x[covered], y[covered]
    skin, thickness = beam(domain, np.append(x, 0.0), np.append(y, 0.0))
    centre = thickness[-1]
    under = np.isfinite(thickness[:-1])
    reach = to_cut(domain.planes, probe)
    return SiteChecks(
        skin_bone_mm=float(centre) if np.isfinite(centre) else None,
        thinnest_under_probe_mm=float(np.nanmin(thickness)) if np.isfinite(thickness).any() else None,
        over_tissue_share=float((skin[:-1] > -probe.width).mean()),
        bone_share=float(under.mean()),
        to_cut_mm=reach,
        gap_at_first_touch_mm=float(np.nanmax(-skin[:-1])) if np.isfinite(skin).any() else float("nan"),
    )


@dataclass(frozen=True)
class LayersKept:
    """Fraction of the requested thickness of the layers that the model has.

    It is given at the probe's centre (NaN without skin there), and as the minimum under the face. Over bone
    the layers are thinned so that some other tissue is left.
    """

    centre: float
    least: float


def layers_kept(domain: TissueDomain, core: TissueDomain, probe: ProbeShape, total: float) -> LayersKept:
    """Compare the layers' thickness along the beam with the requested `total` (mm).

    The thickness runs from the skin of the domain to that of its core.
    """
    x, y = probe.plan(2.0)
    x, y = np.append(x, 0.0), np.append(y, 0.0)
    share = (beam(domain, x, y)[0] - beam(core, x, y)[0]) / total
    known = share[np.isfinite(share)]
    return LayersKept(float(share[-1]), float(known.min()) if len(known) else float("nan"))


def to_cut(planes: Sequence[Plane], probe: ProbeShape) -> float | None:
    """Distance (mm) from the face's outline to the nearest cut, in the site's frame.

    Negative if the cut passes under the face, None without cuts.
    """
    half = np.array([probe.length / 2, probe.width / 2, 0.0])
    reach = [float(each.offset - np.abs(each.normal * half).sum()) for each in planes]
    return min(reach, default=None)


def beam(domain: TissueDomain, x: Array, y: Array) -> tuple[Array, Array]:
    """Height of the skin at plan points, and tissue thickness from there to bone (n,).

    NaN where there is no skin, or no bone below it.
    """
    z = np.arange(10.0, -_DEEPEST, -_STEP)
    grid = np.stack(
        [np.broadcast_to(v, (len(x), len(z))) for v in (x[:, None], y[:, None], z[None, :])], axis=-1
    )
    flat = grid.reshape(-1, 3)
    skin = domain.skin.at(flat).reshape(len(x), len(z))
    height = _first_below(skin, z)
    if domain.bone is None:
        return height, np.full(len(x), np.nan)
    bone = _first_below(domain.bone.at(flat).reshape(len(x), len(z)), z)
    return height, height - bone


def _first_below(values: Array, z: Array) -> Array:
    """Interpolated height at which each row first falls below zero; NaN if it never does."""
    inside = values < 0
    k = np.argmax(inside, axis=1)
    found = inside.any(axis=1) & (k > 0)
    rows = np.arange(len(values))
    a, b = values[rows, k - 1], values[rows, k]
    t = np.where(found, a / np.where(found, a - b, 1.0), 0.0)
    return np.where(found, z[k - 1] + t * (z[k] - z[k - 1]), np.nan)
