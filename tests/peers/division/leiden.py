"""Multiplex Leiden (Traag, Waltman and van Eck 2019), a layer for each graph."""

import igraph
import leidenalg
from scipy import sparse

from .graphs import layers, related
from .search import searched

SEED = 0


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
