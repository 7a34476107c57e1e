"""Spectral clustering, and k-means on positions, as scikit-learn has them."""

import warnings

import numpy
from sklearn.cluster import KMeans, SpectralClustering

from .graphs import layers, related

STARTS = 10
SEED = 0


def every_robot_alone(robots):
    return list(range(robots))


def spectral(observed):
    """Of the sum of the graphs. Robots without any edge are in no team."""
    robots, teams = observed["robots"], observed["teams"]
    graphs = layers(observed)
    if not graphs:
        return None
    has_edges = related(graphs)
    places = numpy.flatnonzero(has_edges)
    # The library needs more robots than teams; there is one division of as many.
    if len(places) <= teams:
        return [int(numpy.searchsorted(places, i)) if has_edges[i] else None for i in range(robots)]
    affinity = sum(graphs).tocsr()[places][:, places]
    method = SpectralClustering(
        affinity="precomputed",
        n_clusters=teams,
        assign_labels="kmeans",
        random_state=SEED,
        n_init=STARTS,
    )
    with warnings.catch_warnings():
        # That a graph has several parts is no fault of a fleet.
        warnings.simplefilter("ignore", UserWarning)
        # As a whole, so that the library may fall back to an exact solver for a few robots.
        labels = method.fit_predict(affinity.toarray())
    found = [None] * robots
    for place, label in zip(places, labels):
        found[place] = int(label)
    return found


def kmeans(observed):
    """Of positions. Robots without one are in no team."""
    positions = observed["positions"]
    if positions is None:
        return None
    places = [i for i, position in enumerate(positions) if position is not None]
    if len(places) <= observed["teams"]:
        labels = every_robot_alone(len(places))
    else:
        method = KMeans(n_clusters=observed["teams"], n_init=STARTS, random_state=SEED)
        labels = method.fit_predict(numpy.array([positions[i] for i in places]))
    found = [None] * len(positions)
    for place, label in zip(places, labels):
        found[place] = int(label)
    return found
