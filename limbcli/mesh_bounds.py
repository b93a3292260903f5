"""What sizes a mesh may be asked for (lowest, largest, mm): in case.toml, on the command line, in Python."""

from __future__ import annotations

from typing import Final

SIZE_MM: Final = (0.8, 10.0)  # edge length under the probe: finer takes hours, coarser misses its edge
FAR_SIZE_MM: Final = (0.8, 25.0)  # edge length far from it
MARGIN_MM: Final = (5.0, 150.0)  # tissue kept beyond the probe
