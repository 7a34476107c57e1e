#!/usr/bin/env python3
"""Compares components, articulation points, bridges and conductances of shared/numeric with networkx.

    python3 -m venv venv && venv/bin/pip install -r tests/peers/requirements.txt
    cargo build --package muster-numeric --example cuts
    venv/bin/python tests/peers/check_cuts.py target/debug/examples/cuts [--seed S] [--cases N]

The graphs are sparse random ones, trees, rings with tails, random geometric ones as radios make them, and two dense
groups with few edges between them. For every articulation point and every bridge the parts that it leaves are compared
as well, found by taking it away. Ends with 'N passed, N failed', and code 1 if anything failed.
"""

import argparse
import random
import subprocess
import sys

import networkx as nx

TOLERANCE = 1e-12


def make_graph(rng, number):
    """One of the five kinds, by its number."""
    kind, n, seed = number % 5, rng.randint(1, 60), rng.randrange(2**31)
    if kind == 0:
        return nx.gnm_random_graph(n, rng.randint(0, 2 * n), seed=seed)
    if kind == 1:
        tree = nx.empty_graph(n)
        tree.add_edges_from((node, rng.randrange(node)) for node in range(1, n))
        return tree
    if kind == 2:
        ring = nx.cycle_graph(max(3, n // 2))
        for node in range(len(ring), max(n, len(ring))):
            ring.add_edge(node, rng.randrange(node))
        return ring
    if kind == 3:
        return nx.random_geometric_graph(n, 0.2, seed=seed)
    return nx.planted_partition_graph(2, max(2, n // 2), 0.5, 0.02, seed=seed)


def make_case(seed, number):
    rng = random.Random(f"{seed}/{number}")
    graph = make_graph(rng, number)
    n, groups = graph.number_of_nodes(), rng.randint(1, 4)
    labels = [rng.randint(-1, groups - 1) for _ in range(n)]
    edges = []
    for a, b in graph.edges:
        ends = (a, b) if rng.random() < 0.5 else (b, a)
        edges.append((*ends, rng.randint(1, 9)))
        if rng.random() < 0.5:
            edges.append((ends[1], ends[0], rng.randint(1, 9)))
    rng.shuffle(edges)
    return n, groups, labels, edges


def parts_of(graph, component):
    return sorted((len(part) for part in nx.connected_components(graph.subgraph(component))), reverse=True)


def expected(n, labels, groups, edges):
    graph = nx.empty_graph(n)
    for a, b, weight in edges:
        known = graph.get_edge_data(a, b, {"weight": 0})["weight"]
        graph.add_edge(a, b, weight=known + weight)
    components = sorted(nx.connected_components(graph), key=min)
    of = {node: component for component in components for node in component}
    points = [[node, *parts_of(graph, of[node] - {node})] for node in sorted(nx.articulation_points(graph))]
    bridges = []
    for a, b in sorted(tuple(sorted(edge)) for edge in nx.bridges(graph)):
        without = graph.copy()
        without.remove_edge(a, b)
        bridges.append([a, b, *parts_of(without, of[a])])
    shares = []
    for group in range(groups):
        inside = {node for node in range(n) if labels[node] == group}
        try:
            shares.append(nx.conductance(graph, inside, weight="weight"))
        except ZeroDivisionError:
            shares.append(None)
    return [len(component) for component in components], points, bridges, shares


def read(answer):
    sizes, points, bridges, shares = answer.split(";")
    entries = lambda text: [[int(word) for word in entry.split()] for entry in text.split(",") if entry]
    shares = [None if share == "-" else float(share) for share in shares.split(",") if share]
    return [int(size) for size in sizes.split()], entries(points), entries(bridges), shares


def same_shares(found, wanted):
    pairs = zip(found, wanted, strict=True)
    return all(a is b is None or None not in (a, b) and abs(a - b) <= TOLERANCE for a, b in pairs)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("binary")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--cases", type=int, default=500)
    options = parser.parse_args()
    cases = [make_case(options.seed, number) for number in range(options.cases)]
    lines = []
    for n, groups, labels, edges in cases:
        lines.append(" ".join(map(str, [n, groups, *labels, *(number for edge in edges for number in edge)])))
    run = subprocess.run([options.binary], input="\n".join(lines), capture_output=True, text=True, check=True)
    answers = run.stdout.splitlines()
    failed, points, bridges = abs(len(cases) - len(answers)), 0, 0
    for number, (case, answer) in enumerate(zip(cases, answers)):
        n, groups, labels, edges = case
        wanted, found = expected(n, labels, groups, edges), read(answer)
        points, bridges = points + len(wanted[1]), bridges + len(wanted[2])
        if found[:3] != wanted[:3] or not same_shares(found[3], wanted[3]):
            failed += 1
            print(f"case {number} of seed {options.seed}: {found}, and networkx has {wanted}")
    print(f"{points} articulation points and {bridges} bridges")
    print(f"{len(cases) - failed} passed, {failed} failed")
    sys.exit(failed > 0)


if __name__ == "__main__":
    main()
