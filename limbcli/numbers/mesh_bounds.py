"""Limits (lowest, largest, mm) of requested mesh sizes: in case.toml, on the command line, in Python."""

from __future__ import annotations

from typing import Final

# edge length under the probe: finer takes hours, coarser does not resolve the probe's edge
ELEMENTS = ("tet10", "tet4")  # of the tissue
SIZE_MM: Final = (0.8, 10.0)
FAR_SIZE_MM: Final = (0.8, 25.0)  # edge length far from the probe
MARGIN_MM: Final = (5.0, 150.0)  # width of the tissue kept beyond the probe
LIMB_NODES: Final = (3_000, 400_000)  # nodes of a whole limb
LIMB_SITE_SIZE_MM: Final = (1.5, 20.0)  # its edge length round the sites
SOCKET_STEPS: Final = (1, 200)  # load steps of donning, and of each load
SOCKET_PENALTY: Final = (1.0, 1000.0)  # of the contact with the socket
SOCKET_PENETRATION_MM: Final = (0.0, 2.0)  # tolerance of the contact; 0: penalty alone
LIMB_CUT_MM: Final = (30.0, 1000.0)  # height of its proximal cut above its distal end
