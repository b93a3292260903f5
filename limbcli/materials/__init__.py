"""Constitutive laws. `LAWS` contains all laws by name; see `model.Material` for the conventions."""

from __future__ import annotations

from limbcli.materials.cache import drop_stale_kernels

drop_stale_kernels()

from limbcli.materials.laws import LAWS, register  # noqa: E402
from limbcli.materials.ogden import ogden_type  # noqa: E402
from limbcli.materials.program import Compiled, Program, compile_material  # noqa: E402

__all__ = ["LAWS", "Compiled", "Program", "compile_material", "ogden_type", "register"]
