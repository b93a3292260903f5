"""FEBio's unit systems: a model in another one than mm-N-s is scaled to it.

Times stay; the mass follows from force, length and time. Curves are factors of values, and are not scaled.
"""

from __future__ import annotations

from dataclasses import replace

from limbcli.errors import CaseError
from limbcli.feb.xml import UNITS, Tag, units_of
from limbcli.model import Curved, ElementMap, LimbModel, Load, Material, NodeMap, Step, Support, Value
from limbcli.model.bodies import Contact, Drive, RigidBody, Spring
from limbcli.numbers.math_expressions import Formula
from limbcli.numbers.units import SYSTEMS

_STRESSES = frozenset(
    {"kappa", "mu", "lambda", "ksi", "T0", "c1", "c2", "c3", "c4", "c5", "c6"}
)  # parameters of laws in units of stress
_FREE = frozenset(
    {"alpha", "beta", "lam0", "phi0", "fiber", "ramp", "F0"}
    | {f"{letter}{k}" for k in range(7) for letter in "gtm"}
)  # without units, or in s
_RESIDUALS = ("min_residual", "max_residual")
_ASSUMED_DENSITY = Material("").density


def units_scale(root: Tag) -> tuple[float, float]:
    """(mm, N) of the file's units of length and force.

    Raises CaseError if the unit system is unknown.
    """
    name = units_of(root)
    if name not in SYSTEMS:
        module = root.need("Module").need("units")
        raise module.problem(
            f"the unit system {name!r} is not supported",
            fix=f"use {', '.join(SYSTEMS)}, or convert the model to {UNITS}",
        )
    return SYSTEMS[name]


def scaled(model: LimbModel, length: float, force: float) -> LimbModel:
    """The model in mm-N-s.

    length, force : mm and N of its units

    Raises CaseError if it has a value whose unit is not known.
    """
    by = _Factors(length, force)
    mesh = replace(model.mesh, points=model.mesh.points * length)
    return replace(
        model,
        mesh=mesh,
        materials={name: by.material(each) for name, each in model.materials.items()},
        bodies=tuple(by.body(each) for each in model.bodies),
        supports=tuple(by.support(each) for each in model.supports),
        drives=tuple(by.drive(each) for each in model.drives),
        loads=tuple(by.load(each) for each in model.loads),
        springs=tuple(by.spring(each) for each in model.springs),
        contacts=tuple(by.contact(each) for each in model.contacts),
        steps=tuple(by.step(each) for each in model.steps),
    )


class _Factors:
    def __init__(self, length: float, force: float):
        self.length, self.force = length, force
        self.stress = force / length**2
        self.density = force / length**4

    def material(self, material: Material) -> Material:
        return replace(
            material,
            parameters={name: self._parameter(name, each) for name, each in material.parameters.items()},
            parts=tuple(self.material(part) for part in material.parts),
            density=self._density(material.density),
        )

    def _parameter(self, name: str, value: Value) -> Value:
        if name in _STRESSES:
            return _times(value, self.stress)
        if name == "perm":
            return _times(value, self.length**4 / self.force)
        if name == "fluid_density":
            return _times(value, self.density)
        if name not in _FREE:
            raise _unknown(f"the parameter {name!r} of a law")
        return value

    def _density(self, density: float) -> float:
        return density if density == _ASSUMED_DENSITY else density * self.density

    def body(self, body: RigidBody) -> RigidBody:
        x, y, z = (self.length * each for each in body.center_of_mass)
        return replace(body, center_of_mass=(x, y, z), density=self._density(body.density))

    def support(self, support: Support) -> Support:
        if isinstance(support.value, NodeMap):
            values = support.value.values * self.length
            return replace(support, value=replace(support.value, values=values))
        return support if support.value is None else replace(support, value=support.value * self.length)

    def drive(self, drive: Drive) -> Drive:
        factors = {"displacement": self.length, "force": self.force, "moment": self.force * self.length}
        return replace(drive, value=drive.value * factors.get(drive.kind, 1.0))

    def load(self, load: Load) -> Load:
        forces = dict.fromkeys(("surface force", "nodal force"), self.force)
        factor = {**forces, "body force": self.length}.get(load.kind, self.stress)
        value = (
            each.scaled(self.length, factor) if isinstance(each, Formula) else each * factor
            for each in load.value
        )
        return replace(load, value=tuple(value))

    def spring(self, spring: Spring) -> Spring:
        a, b = (
            (point[0] * self.length, point[1] * self.length, point[2] * self.length)
            for point in (spring.insertion_a, spring.insertion_b)
        )
        return replace(
            spring,
            stiffness=spring.stiffness * self.force / self.length,
            insertion_a=a,
            insertion_b=b,
            free_length=spring.free_length * self.length,
        )

    def contact(self, contact: Contact) -> Contact:
        if contact.kind != "sliding-elastic":
            raise _unknown(f"the contact {contact.name!r} of type {contact.kind}")
        penalty = 1.0 if contact.auto_penalty else self.stress / self.length
        more = dict(contact.more)
        if "offset" in more:
            more["offset"] = repr(float(more["offset"]) * self.length)
        return replace(
            contact,
            penalty=contact.penalty * penalty,
            gap_tolerance=contact.gap_tolerance * self.length,
            search_radius=contact.search_radius * self.length,
            more=more,
        )

    def step(self, step: Step) -> Step:
        limits = {  # FEBio compares them with squares of forces (FESolidSolver2::Quasin)
            name: step.control[name] * self.force**2 for name in _RESIDUALS if step.control.get(name)
        }
        return replace(
            step,
            control={**step.control, **limits},
            supports=tuple(self.support(each) for each in step.supports),
            drives=tuple(self.drive(each) for each in step.drives),
            loads=tuple(self.load(each) for each in step.loads),
        )


def _times(value: Value, factor: float) -> Value:
    if isinstance(value, ElementMap):
        return replace(value, values=value.values * factor)
    if isinstance(value, Curved):
        return replace(value, value=value.value * factor)
    return value if isinstance(value, tuple) else value * factor


def _unknown(what: str) -> CaseError:
    return CaseError(
        f"{what} cannot be converted to {UNITS}", where="model file", fix=f"save the model in {UNITS}"
    )
