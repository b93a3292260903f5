"""The error raised for a matrix that has no usable factor."""

from __future__ import annotations

from limbcli.errors import SolveError


class SingularMatrix(SolveError):
    """The matrix has no usable factor."""


def singular(detail: str) -> SingularMatrix:
    return SingularMatrix(
        f"the stiffness matrix is singular ({detail})",
        where="sparse factorisation",
        fix="constrain every part of the tissue: look for a region or a rigid body without support",
    )
