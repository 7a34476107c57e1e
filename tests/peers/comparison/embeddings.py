"""Whole embeddings by the packages that a user would find: nxt-gem's HOPE and nodevectors' ProNE.

HOPE factorises the same similarity, by a dense inverse, so that its residual and its singular values
are checked. ProNE factorises something else; its time is shown and nothing more.
"""

import os

from . import katz
from .decomposition import RANK, TARGETS, TICK, WARM, spent
from .progress import note
from .timing import Times, ratio
from .worker import Failure, Worker

HOPE_SIZE = 1_000
PRONE_SIZES = (1_000, 10_000, 100_000)
ROUNDS = 5
FRAMES = 5
KIND = "smooth"
FRACTION = 0.9


def start(target):
    """The worker with the old libraries; a Failure that says why there is none."""
    if reason := os.environ.get("MUSTER_PEERS_OLD_MISSING"):
        raise Failure(f"does not install: {reason}")
    script = os.path.join(os.path.dirname(__file__), "old_worker.py")
    return Worker(target / "peers-old" / "bin" / "python", script)


def measure(ours, theirs, folder, robots, problems):
    """Muster cold and from frame to frame, and what the others take for the same graphs."""
    name = f"{robots:,} robots, {KIND}, embeddings"
    ours.ask("fleet", site="tick", robots=robots, graph=KIND, fraction=FRACTION, seed=7)
    jobs = ["prone"] + (["gem"] if robots == HOPE_SIZE else [])
    times = {job: Times() for job in ("cold", "tick", *jobs)}
    missing = {}
    graph, triplets, residual = folder / "graph", folder / "triplets", 0.0
    for number in range(-1, ROUNDS):
        note(f"{name}: round {number + 1}" if number >= 0 else name)
        for _ in range(FRAMES if number >= 0 else WARM):
            alpha = ours.ask("advance", site="tick", spacings=TICK, all=True)["alpha"]
            answer = solve(ours, "tick", None)
            if number >= 0:
                times["tick"].add(number, spent("tick", answer))
        answer = solve(ours, None, triplets)
        if number >= 0:
            times["cold"].add(number, spent("cold", answer))
        sigma = katz.read_triplets(triplets, robots)[1]
        ours.ask("write_graph", site="tick", to=str(graph))
        theirs.ask("load", robots=robots, **{"from": str(graph)})
        for job in [job for job in jobs if job not in missing]:
            try:
                answer = theirs.ask(
                    job, rank=RANK, dims=2 * RANK, alpha=alpha, to=str(triplets)
                )
            except Failure as error:
                missing[job] = str(error)
                continue
            # The first round compiles and warms caches up.
            if number >= 0:
                times[job].add(number, answer["seconds"])
            if job == "gem":
                found = katz.read_triplets(triplets, robots)
                matrix = katz.katz_matrix(katz.read_graph(graph, robots), alpha)
                check = katz.ResidualCheck(matrix, katz.factorise(matrix))
                residual = max(residual, check.residual(found))
                gap = float(abs(found[1] - sigma).max() / sigma[0])
                if not gap <= residual + 2.0 * TARGETS["cold"]:
                    problems.append(f"{name}: singular values of HOPE differ by {gap:.1e}")
    measured = [job for job in jobs if job not in missing]
    return {
        "robots": robots,
        "kind": KIND,
        "fraction": FRACTION,
        "missing": missing,
        "residual": residual,
        "times": {job: times[job].median() for job in ("cold", "tick", *measured)},
        "ratios": {
            job: {own: ratio(times[job], times[own]).record() for own in ("cold", "tick")}
            for job in measured
        },
    }


def solve(ours, stream, to):
    tolerance = TARGETS[stream or "cold"]
    to = str(to) if to else None
    return ours.ask(
        "solve", site="tick", stream=stream, rank=RANK, tolerance=tolerance, threads=1, to=to
    )
