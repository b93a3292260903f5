"""Our own sparse direct solver: supernodal multifrontal L S L^T factorisation using scipy's BLAS.

ordering -> symbolic -> plan -> numeric and shared_fronts -> substitution, and a root front that can
be refactored separately; `solver.Multifrontal` combines them behind `direct.LinearSolver`.
Duff and Reid 1983 (ACM Trans. Math. Softw. 9, 302-325), Liu 1992 (SIAM Rev. 34, 82-109).
"""

from limbcli.fem.linear_solvers.multifrontal.solver import Multifrontal

__all__ = ["Multifrontal"]
