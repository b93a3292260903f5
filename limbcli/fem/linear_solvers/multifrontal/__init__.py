"""A sparse direct solver of our own: supernodal multifrontal L S L^T on the machine's BLAS.

ordering -> symbolic -> plan -> numeric and top -> substitution, and a root that can be
factored again by itself; `solver.Multifrontal` puts them behind `direct.LinearSolver`.
Duff and Reid 1983 (ACM Trans. Math. Softw. 9, 302-325), Liu 1992 (SIAM Rev. 34, 82-109).
"""

from limbcli.fem.linear_solvers.multifrontal.solver import Multifrontal

__all__ = ["Multifrontal"]
