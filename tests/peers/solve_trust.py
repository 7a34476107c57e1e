"""The trust in modalities, by its definition: dense, with every robot examined, in two rounds."""

import numpy as np

CHANCE, NO_SHARE, FULL_SHARE = 0.5, 0.2, 0.35
NEAR_RANKS, FULL_RANK, LEAST_RANK_TRUST = 0.65, 0.8, 0.2
DECAY, STEPS = 0.5, 4
LEAST_MODALITIES, LEAST_ROBOTS = 3, 8

# Similarities within this share of each other are equal.
ROUNDING = 1e-9


class Undecided(Exception):
    """Rounding decides what is found."""


def short_walks(a):
    """The similarity by walks of a few steps."""
    walks, total = np.eye(len(a)), np.zeros_like(a)
    for _ in range(STEPS):
        walks = walks @ a
        total += walks
    return total


def edges_agreement(a, similarity):
    """Per robot, its edges to others as (robot, weight, share of robots that are less similar)."""
    n, all_edges = len(a), []
    for i in range(n):
        others = np.delete(similarity[i], i)
        edges = []
        if len(others) >= 2 and others.max() > 0.0:
            ordered = np.sort(others)
            steps = np.diff(ordered) / np.maximum(ordered[1:], 1e-300)
            if np.any((steps > 0.1 * ROUNDING) & (steps < 10.0 * ROUNDING)):
                raise Undecided
            for j in np.flatnonzero(a[i]):
                if j != i:
                    farther = (others < similarity[i, j] * (1.0 - ROUNDING)).sum()
                    nearer = (others <= similarity[i, j] * (1.0 + ROUNDING)).sum()
                    equal = max(nearer - farther - 1, 0)
                    edges.append((j, a[i, j], (farther + 0.5 * equal) / (n - 1 - 1)))
        all_edges.append(edges)
    return all_edges


def sums(all_edges):
    """Per robot, the sums of weighted agreements and of weights."""
    return np.array(
        [[sum(w * found for _, w, found in edges), sum(w for _, w, _ in edges)] for edges in all_edges]
    )


def mean(found):
    """The mean agreement of all robots; none where nothing was compared."""
    total, weight = found.sum(axis=0)
    return total / weight if weight > 0.0 else None


def examined(names, graphs, norms, weights, trusted):
    """For each graph the factor of its weight, its agreement, and the graph with the trust in each edge; none
    where nothing is examined. Graphs have a norm of at most `norms`; `trusted` are names, or "all"."""
    n = len(graphs[0])
    speaking = [m for m, a in enumerate(graphs) if weights[m] > 0.0 and a.any()]
    speaking.sort(key=lambda m: names[m])
    held = {m: trusted == "all" or names[m] in trusted for m in speaking}
    if len(speaking) < LEAST_MODALITIES or n < LEAST_ROBOTS or all(held.values()):
        return None
    factor = dict.fromkeys(speaking, 1.0)
    # What the last round found in which there were others to compare with.
    own, others = [{m: np.zeros((n, 2)) for m in speaking} for _ in range(2)]
    by_edge, agreement = {}, {}
    for _ in range(2):
        for m in speaking:
            rest = [k for k in speaking if k != m and factor[k] > 0.0]
            if not rest:
                continue
            fused = sum(weights[k] * factor[k] / norms[k] * graphs[k] for k in rest)
            total = sum(weights[k] * factor[k] for k in rest)
            by_others = edges_agreement(graphs[m], short_walks(DECAY / total * fused))
            own[m] = sums(by_others)
            by_edge[m] = by_others
            nearness = short_walks(DECAY / norms[m] * graphs[m])
            # Edges of several modalities between the same robots count each.
            parts = [
                sums(edges_agreement(weights[k] * factor[k] / norms[k] * graphs[k], nearness))
                for k in rest
            ]
            others[m] = sum(parts)
        for m in speaking:
            found = [mean(own[m]), mean(others[m])]
            agreement[m] = max((a for a in found if a is not None), default=None)
        most = max([CHANCE, *(a for a in agreement.values() if a is not None)])
        for m in speaking:
            factor[m] = 1.0
            if agreement[m] is not None and not held[m] and most > CHANCE:
                above = (agreement[m] - CHANCE) / (most - CHANCE)
                factor[m] = min(max((above - NO_SHARE) / (FULL_SHARE - NO_SHARE), 0.0), 1.0)
    found = []
    for m, a in enumerate(graphs):
        if m not in held:
            found.append((1.0, None, a))
            continue
        near = mean(own[m])
        if near is not None and abs(near - NEAR_RANKS) < 1e-9:
            raise Undecided
        doubted = names[m] == "hierarchy" and not held[m] and near is not None and near >= NEAR_RANKS
        found.append((factor[m], agreement[m], weighed(a, by_edge[m]) if doubted else a))
    return found


def weighed(a, by_edge):
    """A graph with each weight multiplied by the trust in the edge, which is 1 for those that lead one way."""
    known = {(i, j): found for i, edges in enumerate(by_edge) for j, _, found in edges}
    result = a.copy()
    for i, j in zip(*np.nonzero(a)):
        if (i, j) in known and (j, i) in known:
            most = max(known[i, j], known[j, i])
            trust = (most - CHANCE) / (FULL_RANK - CHANCE)
            result[i, j] *= min(max(trust, LEAST_RANK_TRUST), 1.0)
    return result
