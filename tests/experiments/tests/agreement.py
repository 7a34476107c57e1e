"""Divides by networkx's Girvan-Newman and embeds by scikit-learn's locally linear embedding.

Reads one JSON list from standard input, and writes one: an answer to each question.
"""

import json
import sys

import networkx as nx
import numpy as np
from sklearn.manifold import LocallyLinearEmbedding


def girvan_newman(nodes, edges, teams):
    graph = nx.Graph()
    graph.add_nodes_from(range(nodes))
    graph.add_edges_from(edges)
    components = list(nx.connected_components(graph))
    if len(components) < teams:
        components = next(
            found for found in nx.community.girvan_newman(graph) if len(found) >= teams
        )
    labels = [0] * nodes
    for label, members in enumerate(components):
        for node in members:
            labels[node] = label
    return labels


def lle(points, neighbours, dimension):
    # Dense eigenvectors: the iterative ones stop at a tolerance.
    method = LocallyLinearEmbedding(
        n_neighbors=neighbours, n_components=dimension, eigen_solver="dense"
    )
    return method.fit_transform(np.array(points)).tolist()


ANSWERS = {"girvan_newman": girvan_newman, "lle": lle}
print(json.dumps([ANSWERS[question.pop("do")](**question) for question in json.load(sys.stdin)]))
