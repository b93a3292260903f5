"""Centres of mass of rigid bodies for which a file gives none: FEBio computes them from the mesh.

Of shells without thickness, and of bodies without mass, the centre is the origin, as in FEBio.

Source: FEBio 4.11, FERigidBody::UpdateCOM, FERigidSolidDomain and FERigidShellDomain::CalculateCOM.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace

import numpy as np

from limbcli.fem.elements.element import shape
from limbcli.fem.elements.quadrature import rule
from limbcli.model import Array, Mesh
from limbcli.model.bodies import RigidBody


def with_centres(
    bodies: Mapping[str, RigidBody], without: Collection[str], mesh: Mesh, thicknesses: Mapping[str, Array]
) -> dict[str, RigidBody]:
    """The bodies, those named in `without` with the centre of their elements.

    thicknesses : (n_cells,), mm, of shell blocks; a shell weighs its area times its thickness
    """
    return {
        name: replace(body, center_of_mass=_centre(body, mesh, thicknesses)) if name in without else body
        for name, body in bodies.items()
    }


def _centre(body: RigidBody, mesh: Mesh, thicknesses: Mapping[str, Array]) -> tuple[float, float, float]:
    moment, volume = np.zeros(3), 0.0
    for block in mesh.blocks:
        if block.name in body.blocks:
            # volume or area (n_cells,) of each cell, and the integral of its position (n_cells, 3)
            at, weights = rule(block.kind)
            N, dN = shape(block.kind, at)
            X = mesh.points[block.cells]
            tangents = np.einsum("cni,gnd->cgid", X, dN)
            if block.is_solid:
                size = np.abs(np.linalg.det(tangents)) * weights
            else:
                normals = np.cross(tangents[..., 0], tangents[..., 1])
                size = np.linalg.norm(normals, axis=-1) * weights
            size, places = size.sum(axis=1), np.einsum("cg,gn,cni->ci", size, N, X)
            if not block.is_solid:
                thickness = thicknesses.get(block.name, np.zeros(len(block.cells)))
                size, places = size * thickness, places * thickness[:, None]
            volume += float(size.sum())
            moment = moment + places.sum(axis=0)
    x, y, z = (moment / volume if volume else np.zeros(3)).tolist()
    return x, y, z
