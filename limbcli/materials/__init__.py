"""Constitutive laws. `LAWS` lists every law by name; see `model.Material` for the convention."""

from __future__ import annotations

from limbcli.materials.laws import LAWS
from limbcli.materials.ogden import ogden_type
from limbcli.materials.program import Compiled, Program, compile_material

__all__ = ["LAWS", "Compiled", "Program", "compile_material", "ogden_type"]
