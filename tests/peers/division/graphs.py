"""Observations as graphs."""

import numpy
from scipy import sparse

LAYERS = ("spatial", "connectivity", "hierarchy")


def matrix(robots, edges):
    """The graph of edges from, to, weight as a sparse matrix."""
    if not edges:
        return sparse.csr_array((robots, robots))
    rows, columns, weights = zip(*edges)
    return sparse.csr_array((weights, (rows, columns)), shape=(robots, robots), dtype=float)


def layers(observed):
    """Each graph that is reported and has an edge, symmetric and divided by its largest weight."""
    found = []
    for name in LAYERS:
        if observed[name]:
            graph = matrix(observed["robots"], observed[name])
            graph = (graph + graph.T) / 2
            found.append(graph / graph.max())
    return found


def related(graphs):
    """Which robots have an edge in any of the graphs."""
    return numpy.asarray(sum(graphs).sum(axis=1)).ravel() > 0
