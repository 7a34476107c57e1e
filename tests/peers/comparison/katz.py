"""The Katz similarity by scipy: the strongest peer, and what measures the residuals of all answers.

S = (I - aA)^-1 - I is never formed: it is applied by solves with M = I - aA.
"""

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import LinearOperator, eigsh, splu, svds

# How exact a solve that measures must be, and after how many steps of refinement at most.
SOLVED = 1e-11
REFINEMENTS = 3
# What computed vectors may be off from orthogonal by rounding: PROPACK holds half of all digits.
ROUNDING = 1e-7


def read_graph(path, robots):
    """The graph in the files that the Rust program writes."""
    starts = np.fromfile(path.with_suffix(".starts"), dtype="<u4").astype(np.int32)
    columns = np.fromfile(path.with_suffix(".columns"), dtype="<u4").astype(np.int32)
    weights = np.fromfile(path.with_suffix(".weights"), dtype="<f8")
    return sp.csr_matrix((weights, columns, starts), shape=(robots, robots))


def read_triplets(path, robots):
    """U, sigma and V as the Rust program writes them."""
    sigma = np.fromfile(path.with_suffix(".sigma"), dtype="<f8")
    u = np.fromfile(path.with_suffix(".u"), dtype="<f8").reshape(robots, sigma.size)
    v = np.fromfile(path.with_suffix(".v"), dtype="<f8").reshape(robots, sigma.size)
    return u, sigma, v


def katz_matrix(graph, alpha):
    """M = I - aA in compressed columns, which is what scipy factorises."""
    return (sp.identity(graph.shape[0], format="csr") - alpha * graph).tocsc()


# Ways of SuperLU: as it chooses, and with columns of their own, which is faster where there is little
# fill. The matrices have dominant diagonals, so that no pivot is needed.
FACTORS = {
    "panels": {},
    "columns": {"relax": 1, "panel_size": 1, "diag_pivot_thresh": 0.0},
}


def factorise(matrix, way="panels"):
    """SuperLU in the order of minimum degree, which fills such matrices least."""
    return splu(
        matrix, permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True}, **FACTORS[way]
    )


def leading_symmetric(graph, alpha, rank, tolerance=0.0):
    """The `rank` leading triplets of S for an undirected graph, from the largest eigenvalues of A.

    Each eigenvalue x of aA is x / (1 - x) of S. A negative one may be among the leading singular values,
    but not for these fleets: the singular values are compared with those of Muster.
    """
    random = np.random.default_rng(1)
    start = random.standard_normal(graph.shape[0])
    values, vectors = eigsh(graph, k=rank, which="LA", tol=tolerance, v0=start)
    values = alpha * values / (1.0 - alpha * values)
    order = np.argsort(values)[::-1]
    return vectors[:, order], values[order], vectors[:, order]


def leading(factors, rank, solver="propack", tolerance=0.0):
    """The `rank` leading triplets of S = M^-1 - I from a factorisation of M: U, sigma and V."""
    n = factors.shape[0]
    similarity = LinearOperator(
        (n, n),
        matvec=lambda x: factors.solve(x) - x,
        rmatvec=lambda x: factors.solve(x, trans="T") - x,
        dtype=np.float64,
    )
    # The same start each time, so that a run can be repeated.
    random = np.random.default_rng(1)
    u, sigma, vt = svds(similarity, k=rank, solver=solver, tol=tolerance, rng=random)
    order = np.argsort(sigma)[::-1]
    return u[:, order], sigma[order], vt[order].T


def by_default(matrix, rank):
    """The same with everything that scipy chooses by itself: COLAMD, ARPACK, full precision."""
    return leading(splu(matrix), rank, "arpack")


class ResidualCheck:
    """Measures residuals by solves that are refined, and refuses those that are not exact to SOLVED.

    Bad factors show in the products with M, so any factors will do.
    """

    def __init__(self, matrix, factors):
        self.matrix = matrix
        self.transposed = matrix.T.tocsc()
        self.factors = factors

    def solve(self, right, transposed):
        matrix = self.transposed if transposed else self.matrix
        trans = "T" if transposed else "N"
        right = np.asfortranarray(right)
        x = self.factors.solve(right, trans=trans)
        for _ in range(REFINEMENTS + 1):
            error = right - matrix @ x
            worst = (np.linalg.norm(error, axis=0) / np.linalg.norm(right, axis=0)).max()
            if worst <= SOLVED:
                return x
            x += self.factors.solve(np.asfortranarray(error), trans=trans)
        raise ArithmeticError(f"solves that measure are off by {worst:.1e}")

    def residual(self, triplets):
        """max_j of |S v - sigma u| and |S' u - sigma v|, relative to sigma_1, for unit vectors.

        Infinite where the vectors are not orthogonal to that precision.
        """
        u, sigma, v = triplets
        u, v = u / np.linalg.norm(u, axis=0), v / np.linalg.norm(v, axis=0)
        right = np.linalg.norm(self.solve(v, False) - v - sigma * u, axis=0)
        left = np.linalg.norm(self.solve(u, True) - u - sigma * v, axis=0)
        residual = float(max(right.max(), left.max()) / sigma[0])
        askew = max(orthogonality(u), orthogonality(v))
        return residual if askew <= max(residual, ROUNDING) else float("inf")


def orthogonality(vectors):
    gram = vectors.T @ vectors
    return float(np.abs(gram - np.eye(len(gram))).max())
