"""Random inputs of `muster solve`, each by its seed and number alone."""

import numpy as np
from scipy.spatial.distance import cdist

from solve_reference import POWERS, fuse, spectral_radius
from solve_trust import Undecided

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
    place = int(min(max(np.floor(np.sqrt(n) / 2.2 + 0.5), 4), 8))
    own = others[:, min(place, n - 1) - 1]
    own = np.maximum(np.minimum(own, 5.0 * others[:, 0]), 0.1 * fleet)
    apart = np.sort(own[own > 0.1 * fleet])
    if len(apart):
        own = np.minimum(own, 3.0 * apart[len(apart) // 4])
    return np.exp(-0.5 * far**2 / (0.85**2 * np.outer(own, own)))


def default_weights(names, graphs):
    """Less for what relates less than half of the robots."""
    weights = []
    for name, a in zip(names, graphs):
        related = np.mean((a > 0).any(axis=0) | (a > 0).any(axis=1))
        base = {"spatial": 0.35, "connectivity": 0.05, "hierarchy": 0.6}[name]
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
    return case, names, graphs, weights


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
    return {"modalities": entries}, [entry["name"] for entry in entries], graphs, weights


def doubtful(rng, robots):
    """Three modalities of the same groups, of which one may be that of other robots, or all may be noise."""
    n = len(robots)
    part = rng.integers(0, int(rng.integers(2, 5)), n)
    together = part[:, None] == part[None, :]
    mistaken = int(rng.integers(0, 4))
    names = [str(name) for name in rng.permutation(["spatial", "hierarchy", "thermal"])]
    graphs, entries = [], []
    weights = rng.dirichlet(3.0 * np.ones(3))
    for number, (name, weight) in enumerate(zip(names, weights)):
        share = np.where(together, rng.uniform(0.2, 0.9), rng.uniform(0.0, 0.1))
        a = uniform(rng, (n, n)) * (rng.random((n, n)) < share)
        np.fill_diagonal(a, 0.0)
        if number == mistaken:
            order = rng.permutation(n)
            a = a[np.ix_(order, order)]
        if name == "hierarchy" and rng.random() < 0.5:
            # Ranks lead both ways, so that each is trusted for itself.
            a = np.triu(a) + 0.5 * np.triu(a).T
        graphs.append(a)
        entries.append({"name": name, "weight": float(weight), "matrix": a.tolist()})
    return {"modalities": entries}, names, graphs, weights


def make_case(seed, number):
    """The input, A*, its spectral radius, and of each modality its weight, trust and agreement."""
    return case_by(np.random.default_rng([seed, number]), hold=False)


def case_by(rng, hold):
    """The same; `hold` leaves every modality trusted."""
    state = rng.bit_generator.state
    n = int(rng.integers(2, 16) if rng.random() < 0.4 else rng.integers(16, 121))
    robots = [f"r{i}" for i in rng.permutation(n)]
    kinds = [observations, doubtful, modalities]
    source = kinds[rng.choice(3, p=[0.15, 0.2, 0.65])]
    case, names, graphs, weights = source(rng, robots)
    case["robots"] = robots
    plain = rng.random() < 0.3
    # What is left out is scaled by degree.
    scale = None if rng.random() < 0.2 else str(rng.choice(["none", "spectral", "degree"]))
    normalize = "none" if plain else scale
    if normalize is not None:
        case["normalize"] = normalize
    live = normalize in (None, "degree")
    self_loops = 0.5 if live else 0.0
    if rng.random() < 0.5:
        self_loops = case["self_loops"] = float(rng.choice([0.0, 0.25, 1.0, 4.0]))
    trusted = "all"
    if source is doubtful and not hold:
        trusted = [] if rng.random() < 0.7 else [names[0]]
    if live or trusted != "all":
        case["trusted"] = trusted
    if trusted == [] and live and rng.random() < 0.5:
        del case["trusted"]
    case["scale"] = "none" if plain else str(rng.choice(list(POWERS)))
    case["rows"] = "none" if plain else str(rng.choice(["none", "unit"]))
    try:
        fused, trust = fuse(names, graphs, weights, normalize or "degree", self_loops, trusted)
    except Undecided:
        rng.bit_generator.state = state
        return case_by(rng, hold=True)
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
    return case, fused, radius, trust
