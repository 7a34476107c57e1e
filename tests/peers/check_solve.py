#!/usr/bin/env python3
"""Compares `muster solve` with numpy, scipy and scikit-learn on random fleets.

    python3 -m venv venv && venv/bin/pip install -r tests/peers/requirements.txt
    venv/bin/python tests/peers/check_solve.py target/release/muster [--seed S] [--cases N]

Every case is one random input, given by the seed and its number alone; --only NUMBER repeats a
single case and prints its input. What is compared, and how closely, stands in TOLERANCE. Singular
vectors are unique up to sign and rotation only, so that their projectors and the inner products of
the rows of the embedding are compared, and only where the gap behind the K-th singular value is
at least GAP of the first. Ends with 'N passed, N failed', and code 1 if anything failed.
"""

import argparse
import json
import os
import subprocess
import sys
import warnings

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import numpy as np
from scipy.sparse.csgraph import connected_components
from scipy.spatial.distance import cdist
from sklearn.cluster import KMeans
from sklearn.metrics import silhouette_samples, silhouette_score

GAP = 1e-6
EPS = np.finfo(float).eps
TOLERANCE = {
    "rho": 1e-9,  # relative, against the largest eigenvalue of each strong component
    "alpha": 1e-9,  # relative
    "katz": 1e-9,  # largest entry of the difference, relative to the largest of S
    "singular values": 1e-9,  # relative to the first
    "dimension": 0.0,  # the rule for "auto", exactly
    "robots without an embedding": 0.0,  # those with weak rows, exactly
    "projectors": 1e-8,  # largest entry of the difference
    "embedding": 1e-8,  # inner products of rows, relative to the longest row
    "labels": 0.0,  # form and numbering, exactly
    "inertia of labels": 1e-9,  # relative to the spread of all rows
    "best inertia": 1e-6,  # relative, above the best of 100 starts of KMeans; see best_inertia
    "silhouettes": 1e-8,  # absolute
    "refusal": 0.0,  # alpha beyond 1/rho ends with code 2 and a message that names it
    "robustness": 0.0,  # the run ends as it should
}


# --- Random graphs: N x N arrays, entry (i, j) the weight of the edge from i to j. ---


def uniform(rng, shape):
    return rng.uniform(0.05, 1.0, shape)


def random_sparse(rng, n):
    return uniform(rng, (n, n)) * (rng.random((n, n)) < min(1.0, rng.uniform(1.0, 6.0) / n))


def random_dense(rng, n):
    return uniform(rng, (n, n)) * (rng.random((n, n)) < rng.uniform(0.3, 1.0))


def symmetric(rng, n):
    upper = np.triu(random_dense(rng, n) if rng.random() < 0.5 else random_sparse(rng, n))
    return upper + np.triu(upper, 1).T


def acyclic(rng, n):
    order = rng.permutation(n)
    return np.triu(random_dense(rng, n), 1)[np.ix_(order, order)]


def command_tree(rng, n):
    a = np.zeros((n, n))
    for child in range(1, n):
        a[rng.integers(child), child] = 1.0
    return a


def self_loops(rng, n):
    return random_sparse(rng, n) + np.diag(uniform(rng, n) * (rng.random(n) < 0.5))


def disconnected(rng, n):
    part = rng.integers(0, max(2, n // 8), n)
    return random_dense(rng, n) * (part[:, None] == part[None, :])


def planted_cliques(rng, n):
    part = rng.integers(0, max(2, n // 10), n)
    noise = random_sparse(rng, n) * rng.uniform(0.0, 0.3)
    return (part[:, None] == part[None, :]) * (1.0 - np.eye(n)) + noise * (noise > 0)


def integer_weights(rng, n):
    return rng.integers(1, 9, (n, n)) * (rng.random((n, n)) < rng.uniform(0.05, 0.6)) * 1.0


def isolated(rng, n):
    alone = rng.random(n) < 0.3
    a = random_sparse(rng, n) + symmetric(rng, n)
    a[alone, :] = 0.0
    a[:, alone] = 0.0
    return a


def ring(rng, n):
    return np.roll(np.eye(n), 1, axis=1)


def star(rng, n):
    a = np.zeros((n, n))
    a[0, 1:] = a[1:, 0] = 1.0
    return a


def complete(rng, n):
    return np.ones((n, n)) - np.eye(n)


def equal_cliques(rng, n):
    part = np.arange(n) % max(1, n // 4)
    return (part[:, None] == part[None, :]) * (1.0 - np.eye(n))


def wide_range(rng, n):
    return random_sparse(rng, n) * 10.0 ** rng.uniform(-6.0, 6.0, (n, n))


def no_edges(rng, n):
    return np.zeros((n, n))


GRAPHS = [
    random_sparse, random_dense, symmetric, acyclic, command_tree, self_loops, disconnected,
    planted_cliques, integer_weights, isolated, ring, star, complete, equal_cliques, wide_range,
]  # fmt: skip


# --- The reference. ---


def spectral_radius(a):
    """The largest eigenvalue of each strong component; 0 without cycles, whatever rounding says."""
    count, component = connected_components(a != 0.0, directed=True, connection="strong")
    radius = 0.0
    for c in range(count):
        nodes = np.flatnonzero(component == c)
        if len(nodes) == 1:
            radius = max(radius, a[nodes[0], nodes[0]])
        else:
            radius = max(radius, np.abs(np.linalg.eigvals(a[np.ix_(nodes, nodes)])).max())
    return radius


def scaled(graphs, weights, normalize):
    total = np.zeros_like(graphs[0])
    for a, weight in zip(graphs, weights):
        norm = np.linalg.norm(a, 2) if normalize == "spectral" and a.any() else 1.0
        total += weight * (a / norm)
    return total


# What counts as a large drop of the singular values, as a share of the largest, in logarithms.
LARGE_DROP = 0.75


# Largest K that the rule chooses.
MAX_RANK = 128

# A row of [U√Σ, V√Σ] that is at most this share of the longest holds nothing.
WEAK_ROW = 1e-8


def last_large_drop(sigma, teams):
    """K by the last large ratio of neighbouring singular values; None where rounding decides."""
    n = len(sigma)
    limit = min(max(teams, 2), n - 1)
    noise = n * EPS * sigma[0]
    if np.any((sigma > noise * 1e-3) & (sigma < noise * 1e3)):
        return None
    rank = int((sigma > noise).sum())
    if rank <= limit:
        return max(rank, 2)
    drops = np.log(sigma[1:limit] / sigma[2 : limit + 1])
    if drops.max() < 1e-6 or np.any(np.abs(drops / drops.max() - LARGE_DROP) < 1e-6):
        return None
    return int(np.flatnonzero(drops >= LARGE_DROP * drops.max())[-1]) + 2


def relative_lengths(u, sigma, v, k):
    """Lengths of the rows of [U√Σ, V√Σ] for k triplets, relative to the longest."""
    squares = (u[:, :k] ** 2 + v[:, :k] ** 2) @ sigma[:k]
    return np.sqrt(squares / squares.max())


def automatic(u, sigma, v, fused, teams):
    """K of the live rule: the last large drop, raised until no robot with an edge has a weak row, or as
    few as any K leaves; None where rounding decides."""
    n = len(sigma)
    if sigma[0] == 0.0:
        return 1
    if n <= 2:
        return n
    ruled = last_large_drop(sigma, teams)
    if ruled is None:
        return None
    related = (fused != 0.0).any(axis=0) | (fused != 0.0).any(axis=1)
    rank = min(int((sigma > n * EPS * sigma[0]).sum()), MAX_RANK)
    counts = {}
    for k in range(min(ruled, rank), rank + 1):
        lengths = relative_lengths(u, sigma, v, k)[related]
        if np.any((lengths > WEAK_ROW * 1e-2) & (lengths < WEAK_ROW * 1e2)):
            return None
        counts[k] = int((lengths > WEAK_ROW).sum())
    most = max(counts.values())
    if ruled >= rank:
        return ruled
    raised = min(k for k, count in counts.items() if count == most)
    # Which of several equal directions come first is arbitrary, and so are their members.
    for k in range(ruled, raised + 1):
        if k < n and (sigma[k - 1] - sigma[k]) / sigma[0] < GAP and raised > ruled:
            return None
    return raised


# By which power of its singular value each vector is scaled.
POWERS = {"none": 0.0, "sqrt-sigma": 0.5, "inverse-sqrt-sigma": -0.5}


def rows_of(u, sigma, v, scale):
    factors = sigma ** POWERS[scale]
    return np.hstack([u * factors, v * factors])


def inertia_of(x, labels):
    return sum(
        ((x[labels == label] - x[labels == label].mean(axis=0)) ** 2).sum()
        for label in np.unique(labels)
    )


# --- Cases. ---


def near(case, rng, far):
    """The spatial weights of distances, by the fleet or by the robots' own."""
    n = len(far)
    if n < 2:
        return np.zeros((n, n))
    others = np.sort(far + np.diag([np.inf] * n), axis=1)[:, : n - 1]
    fleet = np.median(others[:, 0])
    if rng.random() < 0.3:
        case["spatial"] = {"scale": "fleet", "width": 2.0}
        return np.exp(-0.5 * (far / (2.0 * fleet)) ** 2)
    place = int(min(max(np.floor(np.sqrt(n) / 2.2 + 0.5), 2), 8))
    own = others[:, min(place, n - 1) - 1]
    own = np.maximum(np.minimum(own, 3.0 * others[:, 0]), 0.1 * fleet)
    return np.exp(-0.5 * far**2 / (0.49 * np.outer(own, own)))


def default_weights(names, graphs):
    """Less for what relates less than half of the robots."""
    weights = []
    for name, a in zip(names, graphs):
        related = np.mean((a > 0).any(axis=0) | (a > 0).any(axis=1))
        base = {"spatial": 0.35, "connectivity": 0.1, "hierarchy": 0.55}[name]
        weights.append(base * (min(1.0, 2.0 * related) if related > 0 else 1.0))
    return np.array(weights) / sum(weights)


def observations(rng, robots):
    """Raw observations, and the graphs that they stand for."""
    n = len(robots)
    case, graphs, names = {}, [], []
    if rng.random() < 0.8:
        at = rng.normal(0.0, 1.0, (n, 3)) + 6.0 * rng.integers(0, 3, (n, 1))
        case["poses"] = {r: dict(zip("xyz", map(float, p))) for r, p in zip(robots, at)}
        a = near(case, rng, cdist(at, at))
        np.fill_diagonal(a, 0.0)
        graphs.append(a * (a >= 1e-12))
        names.append("spatial")
    quality = rng.uniform(0.0, 1.0, (n, n)) * (rng.random((n, n)) < min(1.0, 4.0 / n))
    np.fill_diagonal(quality, 0.0)
    case["links"] = {
        r: [{"peer": robots[j], "quality": quality[i, j]} for j in np.flatnonzero(quality[i])]
        for i, r in enumerate(robots)
    }
    graphs.append(quality.T.copy())
    names.append("connectivity")
    if rng.random() < 0.8:
        a = command_tree(rng, n) * rng.uniform(0.5, 2.0)
        case["ranks"] = {}
        for i, robot in enumerate(robots):
            superior = np.flatnonzero(a[:, i])
            case["ranks"][robot] = (
                {"superior": robots[superior[0]], "weight": a[superior[0], i]}
                if len(superior) else {"superior": None}
            )  # fmt: skip
        graphs.append(a)
        names.append("hierarchy")
    weights = default_weights(names, graphs)
    if rng.random() < 0.5:
        weights = rng.dirichlet(np.ones(len(graphs)))
        case["weights"] = dict(zip(names, map(float, weights)))
    back = {"hierarchy": 0.5}
    if rng.random() < 0.5:
        back = {name: float(rng.uniform(0.0, 1.0)) for name in names if rng.random() < 0.5}
        case["reciprocity"] = back
    graphs = [a + back.get(name, 0.0) * a.T for name, a in zip(names, graphs)]
    return case, graphs, weights


def modalities(rng, robots):
    n = len(robots)
    count = int(rng.integers(1, 4))
    kinds = rng.choice(len(GRAPHS), count)
    graphs = [GRAPHS[kind](rng, n) * 1.0 for kind in kinds]
    if rng.random() < 0.1:
        graphs.append(no_edges(rng, n))
    weights = rng.dirichlet(np.ones(len(graphs)))
    entries = []
    for number, (a, weight) in enumerate(zip(graphs, weights)):
        entry = {"name": f"m{number}", "weight": float(weight)}
        if rng.random() < 0.5:
            entry["matrix"] = a.tolist()
        else:
            edges = [[robots[i], robots[j], a[i, j]] for i, j in zip(*np.nonzero(a))]
            entry["edges"] = [edges[k] for k in rng.permutation(len(edges))]
        entries.append(entry)
    return {"modalities": entries}, graphs, weights


def make_case(seed, number):
    rng = np.random.default_rng([seed, number])
    n = int(rng.integers(2, 16) if rng.random() < 0.4 else rng.integers(16, 121))
    robots = [f"r{i}" for i in rng.permutation(n)]
    source = observations if rng.random() < 0.15 else modalities
    case, graphs, weights = source(rng, robots)
    case["robots"] = robots
    plain = rng.random() < 0.3
    case["normalize"] = "none" if plain else str(rng.choice(["none", "spectral"]))
    case["scale"] = "none" if plain else str(rng.choice(list(POWERS)))
    case["rows"] = "none" if plain else str(rng.choice(["none", "unit"]))
    fused = scaled(graphs, weights, case["normalize"])
    radius = spectral_radius(fused)
    fraction = float(rng.choice([0.1, 0.5, 0.85, 0.99]))
    if radius > 0.0 and rng.random() < 0.5:
        case["alpha"] = float(fraction / radius)
    else:
        case["alpha"] = {"fraction": fraction}
    if rng.random() < 0.5:
        case["dimension"] = "auto"
    else:
        case["dimension"] = 2 * int(rng.integers(1, min(n, 10) + 1))
    if rng.random() < 0.2:
        case["labels"] = rng.choice([0, 1, 2, 5, 40], n).tolist()
    else:
        case["teams"] = int(rng.integers(1, min(n, 8) + 1))
        case["init"] = str(rng.choice(["kmeans++", "random"]))
        case["restarts"] = 100
        case["seed"] = int(rng.integers(0, 2**32))
    case["emit"] = ["katz", "embedding", "diagnostics"]
    return case, fused, radius


def run(binary, case):
    command = [binary, "solve", "-", "--json"]
    return subprocess.run(command, input=json.dumps(case), capture_output=True, text=True)


class Tally:
    """Counts of checks, and the largest deviation of each kind."""

    def __init__(self):
        self.passed = dict.fromkeys(TOLERANCE, 0)
        self.failed = dict.fromkeys(TOLERANCE, 0)
        self.worst = dict.fromkeys(TOLERANCE, 0.0)
        # The inertia of 100 starts against 100 starts of scikit-learn.
        self.starts = {"better": 0, "equal": 0, "worse": 0}

    def check(self, kind, number, deviation, detail=""):
        deviation = float(deviation)
        if deviation <= TOLERANCE[kind]:  # False for NaN
            self.passed[kind] += 1
            self.worst[kind] = max(self.worst[kind], deviation)
        else:
            self.failed[kind] += 1
            print(f"case {number}: {kind} is off by {deviation:.3g} {detail}", file=sys.stderr)


def apart(found, expected):
    """Largest difference; infinite between different shapes."""
    found, expected = np.asarray(found, float), np.asarray(expected, float)
    return np.abs(found - expected).max(initial=0.0) if found.shape == expected.shape else np.inf


def distance(found, expected):
    """Largest difference relative to the largest expected entry."""
    top = np.abs(expected).max(initial=0.0)
    return apart(found, expected) / (top if top > 0.0 else 1.0)


def seen_by(found):
    """Which robots have an embedding."""
    unseen = set(found["diagnostics"]["unseen"])
    return np.array([robot not in unseen for robot in found["robots"]])


def divided_inertia(found):
    """The inertia of what k-means divides: robots without an embedding are left out."""
    seen = seen_by(found)
    return inertia_of(np.array(found["embedding"])[seen], np.array(found["labels"])[seen])


def best_inertia(binary, case, number, found, noise, tally):
    """Compares with as many starts of scikit-learn, chosen in the same way.

    Both are heuristics, and either may miss what the other finds in the same number of starts;
    what must not happen is that muster cannot find it: where it is worse it gets 10,000 starts.
    """
    inertia, x = divided_inertia(found), np.array(found["embedding"])[seen_by(found)]
    if len(x) == 0:
        return
    init = {"kmeans++": "k-means++", "random": "random"}[case["init"]]
    peer = KMeans(min(case["teams"], len(x)), init=init, n_init=100, max_iter=1000, tol=0.0, random_state=number)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # fewer distinct points than clusters
        best = peer.fit(x).inertia_
    tolerated = TOLERANCE["best inertia"] * best + noise
    order = "equal"
    if inertia < best - tolerated:
        order = "better"
    elif inertia > best + tolerated:
        order = "worse"
        ended = run(binary, {**case, "restarts": 10_000})
        inertia = divided_inertia(json.loads(ended.stdout))
    tally.starts[order] += 1
    excess = max(inertia - best - noise, 0.0)
    tally.check("best inertia", number, excess / best if best > 0.0 else excess)


def check_case(binary, seed, number, tally):
    case, fused, radius = make_case(seed, number)
    n = len(fused)
    ended = run(binary, case)
    tally.check("robustness", number, ended.returncode != 0, ended.stderr)
    if ended.returncode != 0:
        return
    found = json.loads(ended.stdout)

    tally.check("rho", number, distance(found["rho"], radius))
    alpha = case["alpha"]
    if isinstance(alpha, dict):
        norm = np.linalg.norm(fused, 2)
        alpha = alpha["fraction"] / (radius or norm or 1.0)
    tally.check("alpha", number, distance(found["alpha"], alpha))
    if radius > 0.0:
        refused = run(binary, {**case, "alpha": 1.000001 / radius})
        named = "alpha" in refused.stderr and refused.returncode == 2 and not refused.stdout
        tally.check("refusal", number, not named, refused.stderr)

    walks = found["alpha"] * fused
    similarity = np.linalg.solve(np.eye(n) - walks, walks)
    tally.check("katz", number, distance(found["katz"], similarity))

    u, sigma, vt = np.linalg.svd(similarity)
    x = np.array(found["embedding"])
    k = x.shape[1] // 2
    top = sigma[0] if sigma[0] > 0.0 else 1.0
    values = np.array(found["singular_values"])
    tally.check("singular values", number, apart(values, sigma[:k]) / top)
    if values.shape != (k,):
        return
    labels = np.array(found["labels"])
    if case["dimension"] == "auto":
        teams = case.get("teams", len(set(case.get("labels", []))))
        expected = automatic(u, sigma, vt.T, fused, teams)
        if expected is not None:
            tally.check("dimension", number, expected != k, f"({k}, not {expected})")
    else:
        tally.check("dimension", number, 2 * k != case["dimension"])

    # Vectors of vanishing singular values are arbitrary and come out as zeros.
    rank = int((values > n * EPS * top).sum())
    following = sigma[rank] if rank < n else 0.0
    if rank > 0 and (sigma[rank - 1] - following) / top >= GAP:
        v = vt.T
        if case["rows"] == "none":
            factors = values[:rank] ** POWERS[case["scale"]]
            for own, reference in ((x[:, :k], u), (x[:, k:], v)):
                part = own[:, :rank] / factors
                projector = reference[:, :rank] @ reference[:, :rank].T
                off = max(apart(part @ part.T, projector), np.abs(own[:, rank:]).max(initial=0.0))
                tally.check("projectors", number, off)
        expected = rows_of(u[:, :rank], sigma[:rank], v[:, :rank], case["scale"])
        by_roots = rows_of(u[:, :rank], sigma[:rank], v[:, :rank], "sqrt-sigma")
        lengths = np.linalg.norm(by_roots, axis=1)
        share = lengths / lengths.max()
        clear = (share <= WEAK_ROW * 1e-2) | (share >= WEAK_ROW * 1e2)
        wrong = np.any(((share > WEAK_ROW) != seen_by(found))[clear])
        tally.check("robots without an embedding", number, wrong)
        kept = np.full(n, True)
        if case["rows"] == "unit":
            # Rows that nearly vanish have no direction that two programs could agree on.
            expected = expected / np.maximum(np.linalg.norm(expected, axis=1), 1e-300)[:, None]
            expected[lengths <= 1e-8 * lengths.max()] = 0.0
            kept = (lengths >= 1e-4 * lengths.max()) | (lengths <= 1e-10 * lengths.max())
        own, reference = x[kept], expected[kept]
        tally.check("embedding", number, distance(own @ own.T, reference @ reference.T))

    if "labels" in case:
        tally.check("labels", number, case["labels"] != found["labels"])
    else:
        first = list(dict.fromkeys(found["labels"]))
        seen = seen_by(found)
        alone = set(labels[~seen])
        good = first == list(range(len(first))) and len(set(labels[seen])) <= case["teams"]
        # Robots without an embedding share a label of their own.
        good = good and len(alone) <= 1 and not alone & set(labels[seen])
        tally.check("labels", number, not good)
    tally.check("labels", number, found["teams"] != dict(zip(case["robots"], found["labels"])))

    spread = ((x - x.mean(axis=0)) ** 2).sum()
    noise = 1e-15 * max((x**2).sum(), 1e-300)
    off = abs(found["inertia"] - inertia_of(x, labels))
    tally.check("inertia of labels", number, max(off - noise, 0.0) / max(spread, noise))
    if "teams" in case:
        best_inertia(binary, case, number, found, noise, tally)

    scores = found["silhouette"]
    if len(set(found["labels"])) < 2:
        undefined = scores == {"mean": None, "per_team": [], "per_robot": []}
        tally.check("silhouettes", number, not undefined)
        return
    if len(set(found["labels"])) == n:
        expected = np.zeros(n)  # all alone, which scikit-learn refuses
    else:
        # Distances from differences: the default loses half of the digits of near points.
        far = cdist(x, x)
        expected = silhouette_samples(far, labels, metric="precomputed")
        mean = silhouette_score(far, labels, metric="precomputed")
        tally.check("silhouettes", number, apart(scores["mean"], mean))
    per_team = [expected[labels == label].mean() for label in np.unique(labels)]
    tally.check("silhouettes", number, apart(scores["per_robot"], expected))
    tally.check("silhouettes", number, apart(scores["per_team"], per_team))


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("binary", help="the muster program")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--cases", type=int, default=300)
    parser.add_argument("--only", type=int, metavar="NUMBER", help="repeat this case alone")
    arguments = parser.parse_args()

    numbers = range(arguments.cases)
    if arguments.only is not None:
        numbers = [arguments.only]
        print(json.dumps(make_case(arguments.seed, arguments.only)[0]))
    tally = Tally()
    for number in numbers:
        check_case(arguments.binary, arguments.seed, number, tally)
    for kind, tolerance in TOLERANCE.items():
        print(
            f"{kind:28} {tally.passed[kind]:5} passed {tally.failed[kind]:3} failed"
            f"   worst {tally.worst[kind]:.1e} of {tolerance:.0e} allowed"
        )
    starts = ", ".join(f"{order} in {count}" for order, count in tally.starts.items())
    print(f"inertia of 100 starts against 100 of scikit-learn: {starts} cases")
    failed = sum(tally.failed.values())
    print(f"{sum(tally.passed.values())} passed, {failed} failed")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
