"""Checks, before anything is computed, that the reference solver supports a model; one-time compilation."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from limbcli import background_processes
from limbcli.errors import SolveError
from limbcli.fem.record_fields import check_record
from limbcli.materials import compile_material
from limbcli.materials.stress import tangents_at_rest
from limbcli.model import LimbModel
from limbcli.progress import Progress

# Smallest admissible eigenvalue of the tangent at rest, as a fraction of the largest: the eigenvalues of a
# law without resistance to shear are round-off.
_LEAST_STIFFNESS = 1e-9


def check_supported(model: LimbModel) -> None:
    """Raise SolveError, naming the feature, if a model uses one that this solver does not support."""
    for contact in model.contacts:
        if contact.kind != "sliding-elastic":
            raise _refused(f"contact of type {contact.kind!r}", f"contact {contact.name!r}")
        what = ""
        if not contact.penalty > 0:
            what = f"its penalty {contact.penalty:g} is not positive: there would be no contact force"
        elif contact.friction < 0:
            what = f"its fric_coeff {contact.friction:g} is below 0"
        if what:
            raise SolveError(
                f"contact {contact.name!r}: {what}",
                where=f"contact {contact.name!r}",
                fix="correct it in the model file",
            )
    for domain in model.domains:
        if domain.material not in model.materials:
            raise _refused(f"domain {domain.block!r} without a material", "domains")
        law = model.materials[domain.material].law
        if law == "biphasic":
            raise _refused("the law 'biphasic'", f"material {domain.material!r}")
        compile_material(model.materials[domain.material], domain.material)
    for drive in (each for step in model.steps[1:] for each in step.drives):
        if drive.relative and drive.is_load:
            raise _refused(f"a relative {drive.kind} in a later step", f"body {drive.body!r}")
    for step in model.steps:
        if step.analysis == "transient":
            raise _refused("a transient analysis (inertia)", "steps of the model")
        if step.control.get("arc_length"):
            raise _refused("the arc-length method, which scales the load,", "steps of the model")
    for record in model.records:
        check_record(record)


def refuse_without_stiffness(model: LimbModel) -> None:
    """Refuse materials that do not resist deformation at rest; those that follow a load curve are skipped.

    Raises SolveError if a tangent at rest has an eigenvalue that is not positive beyond round-off.
    """
    for domain in model.domains:
        compiled = compile_material(model.materials[domain.material], domain.material)
        if compiled.varies:
            continue
        n_cells = len(model.mesh.block(domain.block).cells)
        tangents = tangents_at_rest(compiled.program(n_cells, _at_1))
        stiffness = np.linalg.eigvalsh(tangents) if np.isfinite(tangents).all() else np.full(1, np.nan)
        least = float(stiffness.min())
        if not least > _LEAST_STIFFNESS * stiffness.max():
            raise SolveError(
                f"material {domain.material!r} does not resist deformation: "
                f"its lowest stiffness at rest is {least:.3g} MPa",
                where=f"material {domain.material!r}, cells of {domain.block!r}",
                fix="correct its moduli: those of an Ogden law have a positive sum",
            )


def _at_1(_curve: str) -> float:
    return 1.0


def _refused(what: str, where: str) -> SolveError:
    return SolveError(
        f"{what} is not supported by the reference solver", where=where, fix="run this model with FEBio"
    )


COMPILED = (
    "the bundled solver for this processor (elements, contact, equations): once on this machine, about a "
    "minute on two free cores"
)


def warm_up(progress: Progress) -> None:
    """Report, once, that the kernels are about to be compiled on this machine.

    If other processes are already compiling them, wait for these to finish.
    """
    if not are_there() or background_processes.at_work():
        progress.event("compile", what=COMPILED)
    background_processes.wait()


def are_there() -> bool:
    """Whether the kernels have been compiled on this machine (or in this process) before."""
    from limbcli.fem.elements import simd_kernels

    return bool(simd_kernels.internal_force.signatures) or bool(on_disk())


def on_disk() -> list[Path]:
    """numba's cache index files of the internal-force kernel, which every simulation uses."""
    from limbcli.fem.elements import simd_kernels

    kernel, module = simd_kernels.internal_force, simd_kernels.__name__.rsplit(".", 1)[-1]
    return list(Path(kernel.stats.cache_path).glob(f"{module}.{kernel.__name__}*.nbi"))
