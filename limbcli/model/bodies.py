"""Rigid bodies of a model: their prescribed motion, and what acts on them (springs, contact)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal


@dataclass(frozen=True)
class RigidBody:
    """Shell blocks and attached node sets that move as a rigid body.

    `blocks`: the shell blocks that form it; `node_sets`: tissue nodes attached to it.
    """

    name: str
    center_of_mass: tuple[float, float, float]
    blocks: tuple[str, ...] = ()
    node_sets: tuple[str, ...] = ()
    density: float = 1e-9


@dataclass(frozen=True)
class Drive:
    """The condition prescribed for one degree of freedom of a rigid body.

    dof : "x", "y", "z" (translation) or "u", "v", "w" (rotation about x, y, z)
    kind : "fixed", "displacement", "rotation", "force" or "moment"
    """

    body: str
    dof: Literal["x", "y", "z", "u", "v", "w"]
    kind: Literal["fixed", "displacement", "rotation", "force", "moment"]
    value: float = 0.0
    curve: str | None = None
    relative: bool = False

    @property
    def is_load(self) -> bool:
        """Whether it is a force or a moment, which leaves the degree of freedom free."""
        return self.kind in ("force", "moment")


@dataclass(frozen=True)
class Spring:
    """FEBio's "rigid spring" between two bodies: stiffness k (N/mm), insertion points, free length.

    free_length : mm; 0: the initial length
    """

    name: str
    body_a: str
    body_b: str
    stiffness: float
    insertion_a: tuple[float, float, float]
    insertion_b: tuple[float, float, float]
    free_length: float

    @property
    def slack_length(self) -> float:
        """Length (mm) without force.

        Source: FEBio, FERigidSpring::Init.
        """
        return self.free_length or math.dist(self.insertion_a, self.insertion_b)


@dataclass(frozen=True)
class Contact:
    """FEBio's `sliding-elastic`: a deformable primary surface against a rigid or deformable one.

    penalty_curve : name of the load curve that multiplies the penalty. An interference is resolved over
        load steps by a penalty that grows from nearly 0; None: the penalty is constant
    gap_tolerance_curve : the same for `gap_tolerance`; while large, a load step sets the multipliers once
    `more` holds further FEBio settings by their names, as text ("maxaug": "10").
    """

    primary: str
    secondary: str
    name: str = "probe_contact"
    kind: Literal["sliding-elastic", "sliding-biphasic"] = "sliding-elastic"
    penalty: float = 20.0
    auto_penalty: bool = True
    update_penalty: bool = False
    augmented: bool = False
    tolerance: float = 0.05
    gap_tolerance: float = 0.0
    search_radius: float = 20.0
    friction: float = 0.0
    symmetric: bool = True
    two_pass: bool = False
    knmult: float = 0.0
    search_tolerance: float = 0.01
    more: Mapping[str, str] = field(default_factory=dict)
    penalty_curve: str | None = None
    gap_tolerance_curve: str | None = None

    @property
    def is_augmented(self) -> bool:
        """Whether augmentations are done; as in FEBio 4.11, only if one of the tolerances is positive."""
        return self.augmented and max(self.tolerance, self.gap_tolerance) > 0
