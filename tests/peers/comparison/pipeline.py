"""What it costs that one robot has moved: Muster and the paper's method to the letter.

The latter takes all eigenvalues for the spectral radius, the inverse for the similarity and its full
decomposition, by faer and by LAPACK; the faster counts. Muster does all three too: it bounds the
radius, brings the similarity of all pairs up to date, and finds the leading triplets.
"""

import numpy as np

from . import katz
from .decomposition import EVENT, RANK, TARGETS, WARM, spent
from .progress import note
from .timing import Times, added, ratio, timed

SIZES = (200, 1_000)
ROUNDS = {200: 15, 1_000: 5}
EVENTS = 6
KINDS = ("knn", "smooth")
FRACTION = 0.9
# Singular values are to agree as the residual of Muster's allows, relative to the first.
ROUNDING = 1e-9


def lapack(graph, alpha):
    """Time of the three steps by numpy, and the singular values."""
    a = graph.toarray()

    def work():
        radius = np.abs(np.linalg.eigvals(a)).max()
        similarity = np.linalg.inv(np.eye(len(a)) - alpha * a) - np.eye(len(a))
        return radius, np.linalg.svd(similarity)[1]

    seconds, (radius, sigma) = timed(work)
    return seconds, radius, sigma


def measure(ours, folder, robots, kind, quick, problems):
    name = f"{robots:,} robots, {kind}, whole pipeline"
    about = {"site": "event", "robots": robots, "graph": kind, "fraction": FRACTION, "seed": 7}
    ours.ask("fleet", **about)
    times = {job: Times() for job in ("triplets", "all", "faer", "lapack")}
    path = folder / "graph"
    for number in range(-1, 2 if quick else ROUNDS[robots]):
        note(f"{name}: round {number + 1}" if number >= 0 else name)
        for event in range(EVENTS if number >= 0 else WARM):
            about = ours.ask("advance", site="event", spacings=EVENT, all=False)
            bound = ours.ask("bound", site="event")["seconds"]
            updated = ours.ask("update_similarity", site="event")["seconds"]
            solved = ours.ask(
                "solve",
                site="event",
                stream="event",
                rank=RANK,
                tolerance=TARGETS["event"],
                threads=1,
                to=str(folder / "triplets"),
            )
            if number >= 0:
                triplets = added(bound, spent("event", solved))
                times["triplets"].add(number, triplets)
                times["all"].add(number, added(triplets, updated))
        if number < 0:
            continue
        _, sigma, _ = katz.read_triplets(folder / "triplets", robots)
        ours.ask("write_graph", site="event", to=str(path))
        seconds, radius, expected = lapack(katz.read_graph(path, robots), about["alpha"])
        times["lapack"].add(number, seconds)
        found = ours.ask("literal", site="event")
        parts = (found[step] for step in ("eigenvalues", "inverse", "svd"))
        times["faer"].add(number, added(*parts))
        for peer, values in (("faer", found["sigma"]), ("LAPACK", expected)):
            gap = float(abs(np.array(values[:RANK]) - sigma).max() / sigma[0])
            if not gap <= TARGETS["event"]:
                problems.append(f"{name}: singular values differ from {peer}'s by {gap:.1e}")
        low, high = about["radius"]
        for peer, value in (("faer", found["radius"]), ("LAPACK", radius)):
            if not low * (1.0 - ROUNDING) <= value <= high * (1.0 + ROUNDING):
                problems.append(f"{name}: radius {value} of {peer} is not in [{low}, {high}]")
    faster = min(("faer", "lapack"), key=lambda job: times[job].median())
    return {
        "robots": robots,
        "kind": kind,
        "fraction": FRACTION,
        "faster": faster,
        "times": {job: taken.median() for job, taken in times.items()},
        "ratios": {job: ratio(times[faster], times[job]).record() for job in ("triplets", "all")},
    }
