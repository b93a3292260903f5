"""The tangent as an operator, and its approximate inverse (preconditioner).

The operator is the elastic tangent of the last assembly plus the *exact* contact tangent, which is not
symmetric. The preconditioner is a factor of the symmetric part, possibly from an earlier state. GMRES
corrects the difference in a few iterations, so that neither an unsymmetric nor a fresh factorisation is
needed. The motions of the rigid unknowns, with the tissue that follows them, are corrected exactly, by
deflation (Nicolaides 1987, SIAM J. Numer. Anal. 24, 355-365).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sparse

from limbcli.errors import SolveError
from limbcli.fem.contacts.contact_state import ContactState
from limbcli.fem.elements.assembly import total
from limbcli.fem.equilibrium.stress_jumps import Jumps, find_jumps
from limbcli.fem.motion.state import State
from limbcli.fem.system import System
from limbcli.model import Array
from limbcli.numbers.compiled import njit

_FEW = 0.02  # fraction of touching points changed up to which the root front is not updated


@dataclass(eq=False)
class Tangent:
    """Elastic tangent assembled at `state`, with the border of the rigid unknowns.

    blocks (n_pairs, 3, 3) : stiffness blocks of all node pairs, see `assembly.Pattern`
    columns (n_rigid, n_points, 3) : elastic nodal forces per unit motion of each rigid unknown
    corner (n_rigid, n_rigid) : rigid-rigid part: springs, rotating lever arms of tied forces, elastic forces
    jumps, loads : unsymmetric parts of the tangent, of the laws and of loads that follow the surface;
        `blocks` hold the symmetric part
    """

    system: System
    state: State
    blocks: Array
    columns: Array
    corner: Array
    jumps: Jumps | None = None
    loads: sparse.csr_array | None = None

    def times(self, contact: ContactState, step: Array) -> Array:
        """Tangent times a change of the unknowns."""
        return self.tissue_times(step) + self.system.contact_change(contact, step)

    def tissue_times(self, step: Array) -> Array:
        """Tangent without contact times a change of the unknowns."""
        system = self.system
        n = system.n_tissue
        x = step[:n]
        out = np.zeros_like(step)
        v = system.spread(x)
        elastic = self._times_blocks(v)
        if self.jumps is not None:
            elastic += self.jumps.times(v)
        if self.loads is not None:
            elastic += (self.loads @ v.ravel()).reshape(-1, 3)
        unsymmetric = self.jumps is not None or self.loads is not None
        out[:n] = system.collect(elastic)
        for k, column in enumerate(self.columns):
            out[:n] += column[system.free] * step[n + k]
            if unsymmetric:
                bodies = np.zeros((len(system.bodies), 6))
                system.gather_tied(self.state, elastic, bodies)
                out[n + k] += bodies[system.rigid[k]] / system.arms[k]
            else:
                out[n + k] += column[system.free] @ x
        out[n:] += self.corner @ step[n:]
        return out

    def _times_blocks(self, v: Array) -> Array:
        """The symmetric matrix of all node pairs times v (n_points, 3); the pairs are split over threads."""
        pattern, threads = self.system.pattern, self.system.threads
        parts = [np.zeros_like(v) for _ in range(threads.n)]

        def task(worker: int, begin: int, end: int) -> None:
            rows = np.searchsorted(pattern.first, [begin, end])
            flat = (each.reshape(-1) for each in (self.blocks, v, parts[worker]))
            blocks_times(rows[0], rows[1], pattern.first, pattern.high, *flat)

        threads.run(task, len(pattern.high))
        return total(parts)

    def upper(self) -> Array:
        """CSR values of the upper triangle of the unknowns' matrix (see `assembly.Pattern`)."""
        return self.system.pattern.values(self.blocks)

    def diagonal(self) -> Array:
        """Diagonal (n_tissue,) of the unknowns' matrix."""
        first = self.system.pattern.first
        nodes = np.flatnonzero(np.diff(first))  # the pair (n, n) is the first of node n
        nodal = np.zeros_like(self.state.u)
        nodal[nodes] = np.einsum("nii->ni", self.blocks[first[nodes]])
        return self.system.collect(nodal)


def assemble(system: System, state: State, nodal: Array, *, drag: float = 0.0) -> Tangent:
    """The tangent at a state.

    nodal (n_points, 3) : nodal forces there
    drag : multiple of `System.drag` added to the diagonal
    """
    blocks = system.stiffness(state)
    if drag:
        nodes = np.flatnonzero(np.diff(system.pattern.first))  # the pair (n, n) is the first of node n
        blocks[system.pattern.first[nodes]] += drag * system.drag[nodes, None, None] * np.eye(3)
    columns, corner = _border(system, state, nodal)
    return Tangent(
        system,
        state,
        blocks,
        columns,
        corner,
        find_jumps(system, state),
        system.distributed.unsymmetric(state.u),
    )


def _border(system: System, state: State, nodal: Array) -> tuple[Array, Array]:
    n = len(system.rigid)
    columns = np.zeros((n, *system.X.shape)) if n else np.zeros((0, 1, 3))
    corner = np.zeros((n, n))
    if not n:
        return columns, corner
    follows = []
    for k, (b, dof) in enumerate(system.rigid):
        motion = np.zeros((len(system.bodies), 6))
        motion[b, dof] = 1.0 / system.arms[k]
        v = system.follow(state, motion)
        follows.append(v)
        if v.any():
            columns[k] = system.tangent_times(state, v)
    springs = system.spring_stiffness(state)
    for i, (b, dof) in enumerate(system.rigid):
        for j, (c, other) in enumerate(system.rigid):
            corner[i, j] = springs[6 * b + dof, 6 * c + other]
            if b == c and dof >= 3 and other >= 3 and len(system.bodies[b].tied):
                corner[i, j] += system.tied_turning(state, nodal, b)[dof - 3, other - 3]
            corner[i, j] = corner[i, j] / (system.arms[i] * system.arms[j]) + (follows[i] * columns[j]).sum()
    return columns, corner


class Inverse:
    """Approximate inverse of a tangent, used as preconditioner.

    A factor of the tissue's symmetric part with the exact contact tangent in its root front, and the exact
    tangent for the motions of the rigid unknowns, with which the tissue moves as the factor says. Where the
    skin bends around the edge of the probe, its normals differ from the probe's and the contact tangent is
    far from symmetric: with the symmetric part alone GMRES takes ten times the iterations. That the shear of
    a slip follows its pressure is not in the factor: with its symmetric part the matrix is indefinite, with
    half of that term as a negative stiffness along the slip.

    The tissue part belongs to the state that was factored; the contact part is updated (`follow`) if the
    direct solver has a root front.
    """

    def __init__(self, tangent: Tangent, contact: ContactState, linear: Any):
        self.linear, self.tangent = linear, tangent
        self.taken = self.followed = contact
        self.rooted: Any = linear  # the same object, accessed through its root-front interface
        system = tangent.system
        self.n = system.n_tissue
        if self.n:
            values = system.add_contact(contact, tangent.upper(), couples=False)
            further = [system.couplings(contact, couples=False)] if system.has_couplings else []
            linear.factor(values, *further)
        root = getattr(linear, "root", None)
        self.n_root = 0 if root is None or not system.pairs else len(root)
        if self.n_root:
            rows = np.full(self.n + 1, -1, dtype=np.int64)
            rows[root] = np.arange(self.n_root)
            self.rows = rows[system.equations]
            inside = self._contact(contact, couples=False)
            self.inside = 0.5 * (inside + inside.T)  # contact part contained in the factored matrix
            self._take(self._contact(contact), contact)
        self._set_border(contact)

    def follow(self, contact: ContactState) -> None:
        """Update the root front and the rigid unknowns with the contact tangent, if it changed enough.

        If all contact is lost during the iteration, nothing is updated.
        """
        if not (self.n_root or self.tangent.system.rigid) or not contact.touching.any():
            return
        touching, full = contact.touching, contact.full_tangent
        changed = int((touching != self.taken.touching).sum())
        if self.n_root and (changed > _FEW * touching.sum() or full != self.taken.full_tangent):
            self._take(self._contact(contact), contact)
            self._set_border(contact)
        elif contact is not self.followed:
            products = self._products(contact)
            schur = self.left.T @ products
            if np.linalg.matrix_rank(schur) == len(schur):  # else too few points are left to hold a body
                self.products, self.schur, self.followed = products, schur, contact

    def _take(self, matrix: sparse.csr_array, contact: ContactState) -> None:
        """Update the root front with a contact tangent."""
        self.taken = contact
        if matrix.nnz or self.inside.nnz:
            self.rooted.update_root(matrix - self.inside)

    def _contact(self, contact: ContactState, *, couples: bool = True) -> sparse.csr_array:
        """The contact tangent of the root front's unknowns."""
        return self.tangent.system.contact_matrix(contact, self.rows, self.n_root, couples=couples)

    def _set_border(self, contact: ContactState) -> None:
        """Ways of the tissue with unit motions of the rigid unknowns (`right`), and for forces on the tissue
        the forces on these (`left`), both from the factor."""
        system, n = self.tangent.system, self.n
        n_rigid = len(system.rigid)
        self.right, self.left = np.zeros((2, system.n_unknowns, n_rigid))
        self.right[n:] = self.left[n:] = np.eye(n_rigid)
        border = self._products(contact)
        if n_rigid and n:
            rows = system.contact_rows(contact) + np.stack([system.collect(c) for c in self.tangent.columns])
            for k in range(n_rigid):
                self.right[:n, k] = -self.linear.solve(np.ascontiguousarray(border[:n, k]))
                self.left[:n, k] = -self.linear.solve(rows[k])
        self.products, self.followed = self._products(contact), contact
        self.schur = self.left.T @ self.products
        if n_rigid:
            check_rigid_modes(system, self.schur, border[n:])

    def _products(self, contact: ContactState) -> Array:
        """The tangent times the rigid unknowns' motions (n_unknowns, n_rigid)."""
        columns = [self.tangent.times(contact, each) for each in np.ascontiguousarray(self.right.T)]
        return np.stack(columns, axis=1) if columns else np.zeros_like(self.right)

    def __call__(self, rhs: Array) -> Array:
        out = np.zeros_like(rhs)
        left = rhs
        if len(rhs) > self.n:
            motions = np.linalg.solve(self.schur, self.left.T @ rhs)
            out, left = self.right @ motions, rhs - self.products @ motions
        if self.n:
            out[: self.n] += self.linear.solve(np.ascontiguousarray(left[: self.n]))
        return out


def check_rigid_modes(system: System, schur: Array, corner: Array) -> None:
    """Raise SolveError if a rigid unknown has no stiffness."""
    scale = np.abs(np.diag(corner)).max(initial=0.0)
    weak = np.abs(np.diag(schur)) <= 1e-9 * scale
    if scale == 0.0 or weak.any() or not np.isfinite(schur).all():
        k = int(np.argmin(np.abs(np.diag(schur))))
        b, dof = system.rigid[k]
        name, which = system.bodies[b].name, "xyzuvw"[dof]
        raise SolveError(
            f"rigid body {name!r} moves freely along {which!r}: nothing resists it",
            where=f"rigid body {name!r}, degree of freedom {which!r}",
            fix="fix or prescribe this degree of freedom, or let the probe touch the skin at the start",
            body=name,
            dof=which,
        )


@njit
def blocks_times(begin, end, first, high, blocks, v, out):  # type: ignore[no-untyped-def]
    """out += (blocks of the lower nodes begin..end and their transposes) times v; all arrays are flat."""
    for low in range(begin, end):
        at = 3 * low
        x, y, z = v[at], v[at + 1], v[at + 2]
        a = b = c = 0.0
        for k in range(first[low], first[low + 1]):
            o, q = 3 * high[k], 9 * k
            xx, xy, xz = blocks[q], blocks[q + 1], blocks[q + 2]
            yx, yy, yz = blocks[q + 3], blocks[q + 4], blocks[q + 5]
            zx, zy, zz = blocks[q + 6], blocks[q + 7], blocks[q + 8]
            p, r, s = v[o], v[o + 1], v[o + 2]
            a += xx * p + xy * r + xz * s
            b += yx * p + yy * r + yz * s
            c += zx * p + zy * r + zz * s
            if o != at:
                out[o] += xx * x + yx * y + zx * z
                out[o + 1] += xy * x + yy * y + zy * z
                out[o + 2] += xz * x + yz * y + zz * z
        out[at] += a
        out[at + 1] += b
        out[at + 2] += c
