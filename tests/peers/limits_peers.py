"""Exact assignments and k-means under limits, beside OR-tools and k-means-constrained.

Started by `tests/peers/limits`, which builds what it needs. Both sides get the same costs or points, in alternating
rounds; the costs have to be equal, the inertias are printed side by side. Ends with code 1 if a cost differs.
"""

import argparse
import statistics
import subprocess
import sys
import tempfile
import time
import warnings
from pathlib import Path

import numpy as np
from k_means_constrained import KMeansConstrained
from ortools.graph.python import min_cost_flow

UNIT = 2.0**32  # costs are squared distances in this unit, as in a live fleet
STEP = 0.002  # a robot moves by at most this in a tick; the fleet is 1 wide
ROOM = 0.05  # largest relative deviation of a team from an even share


class Ours:
    """The Rust side: `shared/numeric/examples/limits.rs`."""

    def __init__(self, program):
        pipe = subprocess.PIPE
        self.process = subprocess.Popen([program], stdin=pipe, stdout=pipe, text=True)

    def ask(self, *words):
        print(*words, file=self.process.stdin, flush=True)
        seconds, value = self.process.stdout.readline().split()
        return float(seconds), float(value)


def even(robots, teams):
    share = robots / teams
    return int(share * (1.0 - ROOM)), int(np.ceil(share * (1.0 + ROOM)))


def costs_of(robots, centres):
    far = ((robots[:, None, :] - centres[None, :, :]) ** 2).sum(axis=2)
    return np.ascontiguousarray(np.round(far * UNIT / 2.0).astype(np.int64))


def by_flow(costs, least, most):
    """Seconds of the solver alone, seconds with making its graph, and the least cost, by OR-tools."""
    robots, teams = costs.shape
    begun = time.perf_counter()
    flow, sink = min_cost_flow.SimpleMinCostFlow(), robots + teams
    tails = np.repeat(np.arange(robots, dtype=np.int32), teams)
    heads = robots + np.tile(np.arange(teams, dtype=np.int32), robots)
    ones = np.ones(robots * teams, dtype=np.int64)
    flow.add_arcs_with_capacity_and_unit_cost(tails, heads, ones, costs.ravel())
    columns = robots + np.arange(teams, dtype=np.int32)
    rest = np.full(teams, most - least, dtype=np.int64)
    to_sink = np.full(teams, sink, dtype=np.int32)
    flow.add_arcs_with_capacity_and_unit_cost(columns, to_sink, rest, np.zeros(teams, dtype=np.int64))
    # What a team must have is sent beforehand.
    supply = np.concatenate([np.ones(robots), np.full(teams, -least), [teams * least - robots]])
    flow.set_nodes_supplies(np.arange(sink + 1, dtype=np.int32), supply.astype(np.int64))
    made = time.perf_counter()
    if flow.solve() != flow.OPTIMAL:
        raise RuntimeError("OR-tools finds no assignment")
    ended = time.perf_counter()
    return ended - made, ended - begun, flow.optimal_cost()


def assignments(ours, folder, robots, teams, rounds):
    rng = np.random.default_rng(11)
    places, centres = rng.random((robots, 2)) ** 2, rng.random((teams, 2))
    least, most = even(robots, teams)
    cold, tick, solver, whole, wrong = [], [], [], [], 0
    path = folder / "costs.i64"
    for number in range(-1, rounds):
        costs_of(places, centres).tofile(path)
        costs = np.fromfile(path, dtype=np.int64).reshape(robots, teams)
        seconds, value = ours.ask("assign", path, robots, teams, least, most)
        alone, together, least_cost = by_flow(costs, least, most)
        places += STEP * (2.0 * rng.random(places.shape) - 1.0)
        costs_of(places, centres).tofile(path)
        next_tick, _ = ours.ask("tick", path)
        wrong += value != float(least_cost)
        if number >= 0:  # the first round warms caches up
            cold.append(seconds)
            tick.append(next_tick)
            solver.append(alone)
            whole.append(together)
    middle = statistics.median
    name = f"{robots:,} × {teams} assignment"
    print(f"{name}, cold: {middle(cold) * 1e3:.1f} ms (goal 100 ms)")
    print(f"{name}, next tick: {middle(tick) * 1e3:.2f} ms (goal 3 ms)")
    print(f"{name}, OR-tools: {middle(solver) * 1e3:.1f} ms, with its graph {middle(whole) * 1e3:.1f} ms")
    ratios = [theirs / own for theirs, own in zip(solver, cold)]
    low, high = min(ratios), max(ratios)
    print(f"{name}, OR-tools / ours: {middle(ratios):.2f} ({low:.2f} to {high:.2f}; goal at least 0.5)")
    if wrong:
        print(f"{name}: {wrong} costs differ")
    return wrong


def kmeans(ours, folder, points, teams, dims, rounds, restarts):
    """Ours and the peer with as many starts each. The peer stops at its own tolerance."""
    rng = np.random.default_rng(7)
    centres = rng.random((teams, dims))
    x = centres[rng.integers(teams, size=points)] + 0.3 * rng.standard_normal((points, dims))
    path = folder / "points.f64"
    np.ascontiguousarray(x).tofile(path)
    least, most = even(points, teams)
    own, theirs = [], []
    for _ in range(rounds):
        seconds, inertia = ours.ask("kmeans", path, points, dims, teams, least, most, restarts)
        own.append(seconds)
        model = KMeansConstrained(
            teams, size_min=least, size_max=most, n_init=restarts, max_iter=100, random_state=0
        )
        begun = time.perf_counter()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            model.fit(x)
        theirs.append(time.perf_counter() - begun)
    middle = statistics.median
    name = f"constrained k-means, {points:,} × {teams}, {restarts} starts"
    ratio = middle(theirs) / middle(own)
    worse = 100.0 * (inertia / model.inertia_ - 1.0)
    print(f"{name}: {middle(own):.3f} s, k-means-constrained {middle(theirs):.3f} s")
    print(f"{name}, k-means-constrained / ours: {ratio:.1f} (goal at least 10)")
    print(f"{name}, inertia {inertia:.6g} and {model.inertia_:.6g}: ours {worse:+.3f} % (goal at most +0.1)")


def main():
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("program", help="the example `limits` of muster-numeric")
    options.add_argument("--quick", action="store_true", help="small sizes: only whether it works")
    options = options.parse_args()
    ours = Ours(options.program)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if options.quick:
            wrong = assignments(ours, folder, 500, 8, 2)
            kmeans(ours, folder, 200, 4, 8, 1, 2)
        else:
            wrong = assignments(ours, folder, 10_000, 50, 7)
            kmeans(ours, folder, 1_000, 8, 16, 3, 10)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
