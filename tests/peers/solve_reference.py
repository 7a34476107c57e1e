"""What `muster solve` computes, by numpy and scipy."""

import numpy as np
from scipy.sparse.csgraph import connected_components

from solve_trust import examined

# Singular values nearer to each other than this share of the first are equal: their vectors are not unique.
GAP = 1e-6
EPS = np.finfo(float).eps


def spectral_radius(a):
    """The largest eigenvalue of each strong component; 0 without cycles, whatever rounding says."""
    count, component = connected_components(a != 0.0, directed=True, connection="strong")
    radius = 0.0
    for c in range(count):
        nodes = np.flatnonzero(component == c)
        if len(nodes) == 1:
            radius = max(radius, a[nodes[0], nodes[0]])
        else:
            radius = max(radius, np.abs(np.linalg.eigvals(a[np.ix_(nodes, nodes)])).max())
    return radius


# Degrees are raised by this share of their mean.
RAISED_DEGREE = 0.2


def raised(degrees):
    """Degrees, raised by a share of the mean of those that are not 0."""
    return degrees + RAISED_DEGREE * degrees[degrees > 0.0].mean() if degrees.any() else degrees


def by_degree(a):
    """Each edge divided by the roots of the raised degrees of its ends."""
    outgoing, incoming = np.sqrt(raised(a.sum(axis=1))), np.sqrt(raised(a.sum(axis=0)))
    ends = np.outer(outgoing, incoming)
    return np.divide(a, ends, out=np.zeros_like(a), where=a > 0.0)


def fuse(names, graphs, weights, normalize, self_loops, trusted):
    """A*, and for each graph its weight with the trust in it, the trust and the agreement."""
    # A graph without an edge has no weight beside others.
    used = np.array([a.any() for a in graphs]) * np.array(weights, dtype=float)
    weights = used / used.sum() if used.sum() > 0.0 else np.array(weights, dtype=float)
    degree = normalize == "degree"
    scaled = [by_degree(a) for a in graphs] if degree else graphs
    norms = [np.linalg.norm(a, 2) if normalize == "spectral" and a.any() else 1.0 for a in scaled]
    # Trust takes a bound where nothing is divided.
    bounds = norms
    if normalize == "none":
        bounds = [max([1e-300, *a.sum(axis=0), *a.sum(axis=1)]) for a in scaled]
    found = examined(names, scaled, bounds, weights, trusted)
    if found is None:
        found = [(1.0, None, a) for a in scaled]
    kept = np.array([weight * factor for weight, (factor, _, _) in zip(weights, found)])
    # The sum of the weights stays.
    if kept.sum() > 0.0:
        kept *= sum(weights) / kept.sum()
    total = sum(weight / norm * a for weight, norm, (_, _, a) in zip(kept, norms, found))
    edges = sum((a > 0.0) * (weight > 0.0) for weight, (_, _, a) in zip(kept, found))
    related = (edges > 0).any(axis=0) | (edges > 0).any(axis=1)
    trust = [(w, factor, agreement) for w, (factor, agreement, _) in zip(kept, found)]
    return total + self_loops * np.diag(related * 1.0), trust


def katz_similarity(walks):
    """(I − αA*)⁻¹ − I by elimination without exchange of rows, in extended precision: I − αA* is an M-matrix, of
    which entries off the diagonal are eliminated without cancellation, however badly it is conditioned."""
    n = len(walks)
    m = np.hstack([np.eye(n) - walks, walks]).astype(np.longdouble)
    for c in range(n):
        m[c] /= m[c, c]
        factors = m[:, c].copy()
        factors[c] = 0.0
        m -= np.outer(factors, m[c])
    return m[:, n:].astype(float)


# What counts as a large drop of the singular values, as a share of the largest, in logarithms.
LARGE_DROP = 0.75


# Largest K that the rule chooses.
MAX_RANK = 128

# A row of [U√Σ, V√Σ] that is at most this share of the longest holds nothing.
WEAK_ROW = 1e-8


def last_large_drop(sigma, teams):
    """K by the last large ratio of neighbouring singular values; None where rounding decides."""
    n = len(sigma)
    limit = min(max(teams, 2), n - 1)
    noise = n * EPS * sigma[0]
    if np.any((sigma > noise * 1e-3) & (sigma < noise * 1e3)):
        return None
    rank = int((sigma > noise).sum())
    if rank <= limit:
        return max(rank, 2)
    drops = np.log(sigma[1:limit] / sigma[2 : limit + 1])
    if drops.max() < 1e-6 or np.any(np.abs(drops / drops.max() - LARGE_DROP) < 1e-6):
        return None
    return int(np.flatnonzero(drops >= LARGE_DROP * drops.max())[-1]) + 2


def relative_lengths(u, sigma, v, k):
    """Lengths of the rows of [U√Σ, V√Σ] for k triplets, relative to the longest."""
    squares = (u[:, :k] ** 2 + v[:, :k] ** 2) @ sigma[:k]
    return np.sqrt(squares / squares.max())


def automatic(u, sigma, v, fused, teams):
    """K of the live rule: the last large drop, raised until no robot with an edge has a weak row, or as
    few as any K leaves; None where rounding decides."""
    n = len(sigma)
    if sigma[0] == 0.0:
        return 1
    if n <= 2:
        return n
    ruled = last_large_drop(sigma, teams)
    if ruled is None:
        return None
    related = (fused != 0.0).any(axis=0) | (fused != 0.0).any(axis=1)
    rank = min(int((sigma > n * EPS * sigma[0]).sum()), MAX_RANK)
    counts = {}
    for k in range(min(ruled, rank), rank + 1):
        lengths = relative_lengths(u, sigma, v, k)[related]
        if np.any((lengths > WEAK_ROW * 1e-2) & (lengths < WEAK_ROW * 1e2)):
            return None
        counts[k] = int((lengths > WEAK_ROW).sum())
    most = max(counts.values())
    if ruled >= rank:
        return ruled
    raised = min(k for k, count in counts.items() if count == most)
    # Which of several equal directions come first is arbitrary, and so are their members.
    for k in range(ruled, raised + 1):
        if k < n and (sigma[k - 1] - sigma[k]) / sigma[0] < GAP and raised > ruled:
            return None
    return raised


# By which power of its singular value each vector is scaled.
POWERS = {"none": 0.0, "sqrt-sigma": 0.5, "inverse-sqrt-sigma": -0.5}


def rows_of(u, sigma, v, scale):
    factors = sigma ** POWERS[scale]
    return np.hstack([u * factors, v * factors])


def inertia_of(x, labels):
    return sum(
        ((x[labels == label] - x[labels == label].mean(axis=0)) ** 2).sum()
        for label in np.unique(labels)
    )
