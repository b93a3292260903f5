"""`LimbModel`, the data structure shared by all stages.

Meshing creates it, effects return modified copies, solvers consume it, `feb` writes and reads it.

Everything is immutable; change it with the `with_*` methods or `dataclasses.replace`. Node and cell numbers
count from 0 here (FEBio's from 1; `feb` converts). The node order inside a cell is VTK's, which is also
FEBio's. Rigid bodies and contact are in `bodies`.

Frame of a site's model: z outward along the mean skin normal under the probe, x along the probe's long side,
and z = 0 at the height of the probe face at first touch. The tissue lies at z < 0 under the probe;
indentation depth is -z of the probe face.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from limbcli.errors import CaseError
from limbcli.model.bodies import Contact, Drive, RigidBody, Spring
from limbcli.numbers.math_expressions import Formula

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]

CellKind = Literal["tet4", "tet10", "hex8", "penta6", "tri3", "tri6", "quad4"]
NODES_PER_CELL: dict[str, int] = {
    "tet4": 4, "tet10": 10, "hex8": 8, "penta6": 6, "tri3": 3, "tri6": 6, "quad4": 4,
}  # fmt: skip
FIBRES = "fibres"  # name of the element map of fibre directions
SOLID_KINDS = frozenset({"tet4", "tet10", "hex8", "penta6"})


# ---------------------------------------------------------------- mesh


@dataclass(frozen=True, eq=False)
class Block:
    """Cells of one kind that share a name (FEBio: one `<Elements>` section).

    cells : int array (n_cells, nodes per cell), from 0
    """

    name: str
    kind: CellKind
    cells: IntArray

    @property
    def is_solid(self) -> bool:
        return self.kind in SOLID_KINDS


@dataclass(frozen=True, eq=False)
class Surface:
    """Named facets, by kind: {"tri3": (n, 3), "tri6": (n, 6), "quad4": (n, 4)}, outward normals."""

    name: str
    facets: Mapping[str, IntArray]

    @property
    def n_facets(self) -> int:
        return sum(len(each) for each in self.facets.values())


@dataclass(frozen=True, eq=False)
class Mesh:
    """points (n_points, 3), mm; cells in blocks; named node sets and surfaces.

    Names used by site models: blocks `tissue` (and `fat`, `skin` if layers are requested) and `probe`; node
    sets `bone`, `cut`, `fixed` (bone and cut together), `skin`; surfaces `skin`, `contact` (skin that the
    probe can reach), `bone`, `cut`, `probe_face`.

    node_ids, cell_ids : of the file that the mesh was read from, by number; None: they count from 1
    """

    points: Array
    blocks: tuple[Block, ...]
    node_sets: Mapping[str, IntArray] = field(default_factory=dict)
    surfaces: Mapping[str, Surface] = field(default_factory=dict)
    node_ids: IntArray | None = None
    cell_ids: IntArray | None = None

    def node_id(self, number: int) -> int:
        """A node's id in its file, for messages."""
        return _id(self.node_ids, number)

    def cell_id(self, number: int) -> int:
        """An element's id in its file, for messages; `number` counts over all blocks."""
        return _id(self.cell_ids, number)

    def block(self, name: str) -> Block:
        return next(each for each in self.blocks if each.name == name)

    @property
    def solid_blocks(self) -> tuple[Block, ...]:
        return tuple(each for each in self.blocks if each.is_solid)

    def nodes_of(self, blocks: Iterable[str]) -> IntArray:
        """Nodes (n,) of the cells of these blocks, in increasing order."""
        cells = [self.block(name).cells.ravel() for name in blocks]
        return np.unique(np.concatenate([np.zeros(0, dtype=np.int64), *cells]))

    @property
    def solid_nodes(self) -> IntArray:
        """Nodes (n,) of all solid cells, in increasing order."""
        return self.nodes_of(each.name for each in self.solid_blocks)


def _id(ids: IntArray | None, number: int) -> int:
    return int(ids[number]) if ids is not None and number < len(ids) else number + 1


# ---------------------------------------------------------------- values


@dataclass(frozen=True, eq=False)
class ElementMap:
    """A value for each cell of a block: values (n_cells,) or (n_cells, 3)."""

    name: str
    block: str
    values: Array


@dataclass(frozen=True, eq=False)
class NodeMap:
    """A value for each node of a node set, in the set's order: values (n,)."""

    name: str
    node_set: str
    values: Array


@dataclass(frozen=True)
class Curved:
    """`value` times the load curve named `curve` at the current time."""

    value: float
    curve: str


Value = float | tuple[float, ...] | ElementMap | Curved


@dataclass(frozen=True)
class Curve:
    """A load curve: points (time_s, value) with FEBio's interpolations and extensions, or a formula of t."""

    points: tuple[tuple[float, float], ...]
    interpolate: Literal["linear", "step", "smooth"] = "linear"
    extend: Literal["constant", "extrapolate", "repeat", "repeat offset"] = "constant"
    formula: Formula | None = None


# ---------------------------------------------------------------- material


@dataclass(frozen=True)
class Material:
    """A constitutive law by its name in `limbcli.materials.LAWS`, parameters in the internal convention.

    `parts` are the solids of a mixture, or the elastic base of a wrapper law (viscoelastic, prestrain). The
    Ogden law's parameters are those of FEBio's "Ogden unconstrained": c1..c6, m1..m6 and kappa (its cp), so
    that the ground shear modulus is sum(c)/2 and kappa is Lame's lambda.
    """

    law: str
    parameters: Mapping[str, Value] = field(default_factory=dict)
    parts: tuple[Material, ...] = ()
    density: float = 1e-9

    @property
    def is_viscoelastic(self) -> bool:
        """Whether it is a viscoelastic law or contains one."""
        return self.law == "viscoelastic" or any(part.is_viscoelastic for part in self.parts)

    def with_parameters(self, **changes: Value) -> Material:
        return replace(self, parameters={**self.parameters, **changes})


@dataclass(frozen=True)
class Domain:
    """A solid block and its material.

    rule : a special element formulation ("TET10G4", "ut4-solid"); "elastic-solid" where FEBio would use its
        three-field element (`materials.laws.is_three_field`)
    """

    block: str
    material: str
    rule: str | None = None
    rule_parameters: Mapping[str, float] = field(default_factory=dict)


# ---------------------------------------------------------------- supports, steps, records


@dataclass(frozen=True, eq=False)
class Support:
    """Displacement of a node set, fixed at 0 (`value` None) or prescribed.

    dofs : some of "x", "y", "z"; a prescribed support has exactly one dof. "p" alone is the fluid pressure of
        biphasic tissue, fixed at 0.
    value : multiplied by `curve`; a NodeMap gives each node its own value.
    """

    node_set: str
    dofs: tuple[str, ...]
    value: float | NodeMap | None = None
    curve: str | None = None
    relative: bool = False


@dataclass(frozen=True)
class Load:
    """A load on tissue, multiplied by `curve`.

    kind : "pressure" (value[0], MPa) acts against the outward normal; "traction" (MPa) in a fixed direction;
        "surface force" (N) is spread evenly over the undeformed surface; "nodal force" (N) acts on each node;
        "body force" (mm/s^2) is an acceleration: its force per volume is the material's density times it
    value : its components; a formula is evaluated at each point of the reference state, and at each time
    on : the surface, the node set or the block; of a body force "" is all of the tissue
    on_reference : a pressure or traction acts on the undeformed surface, else on the deformed one
    """

    kind: Literal["pressure", "traction", "surface force", "nodal force", "body force"]
    on: str
    value: tuple[float | Formula, ...]
    curve: str | None = None
    on_reference: bool = False


@dataclass(frozen=True)
class Step:
    """One analysis step of total duration n_steps * step_size, however the time steps are cut or enlarged.

    dt_max : the largest time step; None means `step_size`
    must_points : times (s, from the start of the step) that are reached exactly
    adaptive : if False, every time step is `step_size`, never cut or enlarged; between two must-points the
        time steps are equal, and as close to `step_size` as possible
    dt_max_curve : the load curve of the largest time step, if it is not `dt_max` throughout; its points are
        the must-points
    control : further solver settings by their FEBio names
    """

    n_steps: int = 10
    step_size: float = 0.1
    analysis: Literal["static", "transient"] = "static"
    dt_min: float = 1e-3
    dt_max: float | None = None
    must_points: tuple[float, ...] = ()
    max_retries: int = 8
    opt_iterations: int = 25
    adaptive: bool = True
    dt_max_curve: str | None = None
    control: Mapping[str, Any] = field(default_factory=dict)
    supports: tuple[Support, ...] = ()
    drives: tuple[Drive, ...] = ()
    loads: tuple[Load, ...] = ()


@dataclass(frozen=True, eq=False)
class LogRecord:
    """A table that the solver writes at every converged time step.

    kind : "rigid_body", "node" or "element"; fields : FEBio's names ("Fz", "ux", "sz", "Fxx" ...)
    items : node or cell numbers (from 0, cells counted over all blocks in order), None for all; for
        "rigid_body" the body's name
    """

    kind: Literal["rigid_body", "node", "element"]
    fields: tuple[str, ...]
    file: str
    items: IntArray | str | None = None


# ---------------------------------------------------------------- the model


@dataclass(frozen=True, eq=False)
class LimbModel:
    """Mesh, laws, contact, supports and loads: everything a solver needs, nothing of the case.

    `info` holds plain metadata for pictures and checks (site, probe size, the transform `patient_from_model`
    as 16 numbers row by row, ...). `fibres` is the direction of the muscle fibres in every tissue cell, as
    unit vectors (n_cells, 3) in the site's frame whose sign has no meaning; None if not given. Only laws that
    declare it use them.
    """

    mesh: Mesh
    materials: Mapping[str, Material]
    domains: tuple[Domain, ...]
    bodies: tuple[RigidBody, ...] = ()
    supports: tuple[Support, ...] = ()
    drives: tuple[Drive, ...] = ()
    springs: tuple[Spring, ...] = ()
    contacts: tuple[Contact, ...] = ()
    curves: Mapping[str, Curve] = field(default_factory=dict)
    steps: tuple[Step, ...] = (Step(),)
    records: tuple[LogRecord, ...] = ()
    info: Mapping[str, Any] = field(default_factory=dict)
    fibres: ElementMap | None = None
    loads: tuple[Load, ...] = ()

    @property
    def is_viscoelastic(self) -> bool:
        """Whether a material is viscoelastic, so that the response depends on the sizes of the time steps."""
        return any(each.is_viscoelastic for each in self.materials.values())

    @property
    def remembers(self) -> bool:
        """Whether the response to a load depends on the way to it: viscoelastic materials, friction, or the
        multipliers of a contact, which every time step raises."""
        return self.is_viscoelastic or self.has_friction or any(each.is_augmented for each in self.contacts)

    @property
    def has_friction(self) -> bool:
        """Whether a contact has friction, so that the solution depends on the load path."""
        return any(each.friction for each in self.contacts)

    @property
    def goes_on_from_steps(self) -> bool:
        """Whether a later step fixes or moves something relative to where the preceding step left it."""
        later = self.steps[1:]
        return any(each.relative for step in later for each in step.supports) or any(
            each.relative or each.kind == "fixed" for step in later for each in step.drives
        )

    def with_material(self, name: str, material: Material) -> LimbModel:
        """The model with one material replaced. Raises CaseError if there is no material of that name."""
        if name not in self.materials:
            fix = f"use one of {', '.join(sorted(self.materials))}"
            raise CaseError(f"the model has no material {name!r}", where=f"with_material({name!r})", fix=fix)
        return replace(self, materials={**self.materials, name: material})

    def with_mesh(self, mesh: Mesh) -> LimbModel:
        """The model with another mesh."""
        return replace(self, mesh=mesh)
