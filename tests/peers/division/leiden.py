"""Multiplex Leiden (Traag, Waltman and van Eck 2019), a layer for each graph."""

import igraph
import leidenalg
from scipy import sparse

from .graphs import layers, related

SEED = 0
# Of the search for a resolution.
STEPS = 40
# How much finer or coarser the next resolution is while the number of teams lies beyond all that were tried.
STRIDE = 2.0


def graph(layer):
    upper = sparse.triu(layer, k=1).tocoo()
    edges = list(zip(upper.row.tolist(), upper.col.tolist()))
    return igraph.Graph(n=layer.shape[0], edges=edges, edge_attrs={"weight": upper.data.tolist()})


def divided(graphs, resolution):
    """The team of each robot."""
    labels, _ = leidenalg.find_partition_multiplex(
        graphs,
        leidenalg.RBConfigurationVertexPartition,
        weights="weight",
        resolution_parameter=resolution,
        seed=SEED,
    )
    return labels


def searched(count, wanted):
    """The resolution for which `count` gives the number that is wanted, or comes nearest to it.

    The number grows with the resolution, by and large: the search doubles or halves it until the number lies
    between two resolutions, and then halves the ratio of these.
    """
    low = high = None
    resolution, best = 1.0, None
    for _ in range(STEPS):
        found = count(resolution)
        if best is None or abs(found - wanted) < abs(best[0] - wanted):
            best = (found, resolution)
        if found == wanted:
            break
        if found < wanted:
            low = resolution
        else:
            high = resolution
        if low is None:
            resolution = high / STRIDE
        elif high is None:
            resolution = low * STRIDE
        else:
            resolution = (low * high) ** 0.5
    return best[1]


def leiden(observed):
    """Without and with the number of teams. Robots without any edge are in no team."""
    found = layers(observed)
    if not found:
        return None, None
    has_edges = related(found).tolist()
    graphs = [graph(layer) for layer in found]
    seen = {}

    def labels(resolution):
        if resolution not in seen:
            all_labels = divided(graphs, resolution)
            seen[resolution] = [
                label if has_edge else None for label, has_edge in zip(all_labels, has_edges)
            ]
        return seen[resolution]

    def count(resolution):
        return len(set(labels(resolution)) - {None})

    return labels(1.0), labels(searched(count, observed["teams"]))
