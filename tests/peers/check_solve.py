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
from scipy.spatial.distance import cdist
from sklearn.cluster import KMeans
from sklearn.metrics import silhouette_samples, silhouette_score

from solve_cases import make_case
from solve_reference import (
    EPS, GAP, POWERS, WEAK_ROW, automatic, inertia_of, katz_similarity, rows_of,
)  # fmt: skip

TOLERANCE = {
    "weights": 1e-9,  # absolute, with the trust in each
    "trust": 1e-9,  # absolute
    "agreement": 1e-9,  # absolute
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

# Share of the extent of a fleet, the largest distance from its mean, up to which robots are in the same place.
SAME_PLACE = 1e-12


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


def with_embedding(found):
    """Which robots have an embedding."""
    without = set(found["diagnostics"]["unseen"])
    return np.array([robot not in without for robot in found["robots"]])


def divided_inertia(found):
    """The inertia of what k-means divides: robots without an embedding are left out."""
    embedded = with_embedding(found)
    return inertia_of(np.array(found["embedding"])[embedded], np.array(found["labels"])[embedded])


def best_inertia(binary, case, number, found, noise, tally):
    """Compares with as many starts of scikit-learn, chosen in the same way.

    Both are heuristics, and either may miss what the other finds in the same number of starts;
    what must not happen is that muster cannot find it: where it is worse it gets 10,000 starts.
    """
    inertia, x = divided_inertia(found), np.array(found["embedding"])[with_embedding(found)]
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
    case, fused, radius, trust = make_case(seed, number)
    n = len(fused)
    ended = run(binary, case)
    tally.check("robustness", number, ended.returncode != 0, ended.stderr)
    if ended.returncode != 0:
        return
    found = json.loads(ended.stdout)

    check_trust(number, found, trust, tally)
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
    similarity = katz_similarity(walks)
    tally.check("katz", number, distance(found["katz"], similarity))

    u, sigma, vt = np.linalg.svd(similarity)
    x = np.array(found["embedding"])
    k = x.shape[1] // 2
    top = sigma[0] if sigma[0] > 0.0 else 1.0
    values = np.array(found["singular_values"])
    tally.check("singular values", number, apart(values, sigma[:k]) / top)
    if values.shape != (k,):
        return
    if case["dimension"] == "auto":
        teams = case.get("teams", len(set(case.get("labels", []))))
        expected = automatic(u, sigma, vt.T, fused, teams)
        if expected is not None:
            tally.check("dimension", number, expected != k, f"({k}, not {expected})")
    else:
        tally.check("dimension", number, 2 * k != case["dimension"])

    check_vectors(case, number, found, (u, sigma, vt.T), tally)
    check_labels(binary, case, number, found, tally)
    check_silhouettes(number, found, tally)


def check_trust(number, found, expected, tally):
    modalities = found["modalities"]
    for kind, key, place in (("weights", "weight", 0), ("trust", "trust", 1)):
        values = [modality[key] for modality in modalities]
        tally.check(kind, number, apart(values, [of[place] for of in expected]))
    agreements = [modality["agreement"] for modality in modalities]
    wanted = [of[2] for of in expected]
    same = [a is None for a in agreements] == [a is None for a in wanted]
    numbers = [np.array([a for a in all if a is not None]) for all in (agreements, wanted)]
    tally.check("agreement", number, apart(*numbers) if same else np.inf)


def check_vectors(case, number, found, triplets, tally):
    u, sigma, v = triplets
    n, values, x = len(sigma), np.array(found["singular_values"]), np.array(found["embedding"])
    k, top = len(values), sigma[0] if sigma[0] > 0.0 else 1.0
    # Vectors of vanishing singular values are arbitrary and come out as zeros.
    rank = int((values > n * EPS * top).sum())
    following = sigma[rank] if rank < n else 0.0
    if rank == 0 or (sigma[rank - 1] - following) / top < GAP:
        return
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
    wrong = np.any(((share > WEAK_ROW) != with_embedding(found))[clear])
    tally.check("robots without an embedding", number, wrong)
    kept = np.full(n, True)
    if case["rows"] == "unit":
        # Rows that nearly vanish have no direction that two programs could agree on.
        expected = expected / np.maximum(np.linalg.norm(expected, axis=1), 1e-300)[:, None]
        expected[lengths <= 1e-8 * lengths.max()] = 0.0
        kept = (lengths >= 1e-4 * lengths.max()) | (lengths <= 1e-10 * lengths.max())
    own, reference = x[kept], expected[kept]
    tally.check("embedding", number, distance(own @ own.T, reference @ reference.T))


def check_labels(binary, case, number, found, tally):
    labels, x = np.array(found["labels"]), np.array(found["embedding"])
    if "labels" in case:
        tally.check("labels", number, case["labels"] != found["labels"])
    else:
        first = list(dict.fromkeys(found["labels"]))
        embedded = with_embedding(found)
        alone = set(labels[~embedded])
        good = first == list(range(len(first))) and len(set(labels[embedded])) <= case["teams"]
        # Robots without an embedding share a label of their own.
        good = good and len(alone) <= 1 and not alone & set(labels[embedded])
        tally.check("labels", number, not good)
    tally.check("labels", number, found["teams"] != dict(zip(case["robots"], found["labels"])))

    spread = ((x - x.mean(axis=0)) ** 2).sum()
    noise = 1e-15 * max((x**2).sum(), 1e-300)
    off = abs(found["inertia"] - inertia_of(x, labels))
    tally.check("inertia of labels", number, max(off - noise, 0.0) / max(spread, noise))
    if "teams" in case:
        best_inertia(binary, case, number, found, noise, tally)


def check_silhouettes(number, found, tally):
    labels, x = np.array(found["labels"]), np.array(found["embedding"])
    n, scores = len(labels), found["silhouette"]
    if len(set(found["labels"])) < 2:
        undefined = scores == {"mean": None, "per_team": [], "per_robot": []}
        tally.check("silhouettes", number, not undefined)
        return
    if len(set(found["labels"])) == n:
        expected = np.zeros(n)  # all alone, which scikit-learn refuses
    else:
        # Distances from differences: the default loses half of the digits of near points.
        far = cdist(x, x)
        # What rounding says of robots in the same place is noise, which scikit-learn takes for distances.
        far[far <= SAME_PLACE * np.linalg.norm(x - x.mean(axis=0), axis=1).max()] = 0.0
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
