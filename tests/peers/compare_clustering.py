#!/usr/bin/env python3
"""Times Muster's k-means and silhouettes beside scikit-learn's and linfa's, one thread each.

    python3 -m venv venv && venv/bin/pip install -r tests/peers/requirements.txt
    cargo build --release --manifest-path tests/peers/rust/Cargo.toml
    venv/bin/python tests/peers/compare_clustering.py tests/peers/rust/target/release/muster-peers

All get the same points, the same first centroids and the same number of iterations, in one run, in
rounds that take turns, so that what else the machine does hits all of them. Printed are medians in
milliseconds, their ratios, the rate of Muster's k-means, and what was found: the inertia of the
labels about their own means, and mean silhouettes. Ends with code 1 if these differ by more than
TOLERANCE. Inertias of linfa are only shown: it counts the centroid before as one more point of each
cluster, so that it takes another way.

Options: --rounds (5), --slow for silhouettes of 100,000 points, which take scikit-learn minutes.
"""

import argparse
import os
import platform
import statistics
import subprocess
import sys
import tempfile
import time
import warnings

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "RAYON_NUM_THREADS"):
    os.environ[name] = "1"

import numpy as np
import sklearn
from sklearn.cluster import KMeans
from sklearn.metrics import silhouette_score

KMEANS = [(1_000, 16, 8, 20), (10_000, 16, 8, 20), (100_000, 16, 8, 20), (100_000, 32, 50, 20)]
SILHOUETTES = [(1_000, 16, 8), (10_000, 16, 8)]
SLOW_SILHOUETTES = [(100_000, 16, 8)]
TOLERANCE = {
    "inertia": 1e-9,  # relative
    "silhouette": 1e-8,  # absolute
    "sampled": 5.0,  # in standard errors
}


def points(n, dims, clusters):
    """Normal clouds about as wide as their centres stand apart, so that clusters overlap."""
    rng = np.random.default_rng(7)
    centres = rng.random((clusters, dims))
    x = centres[rng.integers(clusters, size=n)] + 0.3 * rng.standard_normal((n, dims))
    return np.ascontiguousarray(x)


def inertia(x, labels):
    means = np.array([x[labels == c].mean(axis=0) for c in range(labels.max() + 1)])
    return float(((x - means[labels]) ** 2).sum())


class Peer:
    """The Rust program, which keeps the points between jobs."""

    def __init__(self, program, x, clusters, iterations):
        with tempfile.NamedTemporaryFile(suffix=".f64", delete=False) as file:
            x.tofile(file)
        self.file = file.name
        size = [str(v) for v in (*x.shape, clusters, iterations)]
        command = [program, self.file, *size]
        self.process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )

    def run(self, job):
        self.process.stdin.write(job + "\n")
        self.process.stdin.flush()
        line = self.process.stdout.readline().split()
        if not line:
            sys.exit(f"{job}: no answer")
        return [float(v) for v in line]

    def close(self):
        self.process.stdin.close()
        self.process.wait()
        os.unlink(self.file)


def timed(work):
    start = time.perf_counter()
    result = work()
    return time.perf_counter() - start, result


def medians(rounds, jobs):
    """Runs all jobs in turn; median time and last result of each."""
    times = {name: [] for name in jobs}
    results = {}
    for number in range(rounds + 1):
        for name, job in jobs.items():
            seconds, *result = job()
            results[name] = result
            if number > 0:  # The first round warms caches up.
                times[name].append(seconds)
    return {name: statistics.median(t) for name, t in times.items()}, results


def compare_kmeans(program, rounds, size):
    n, dims, clusters, iterations = size
    x = points(n, dims, clusters)
    peer = Peer(program, x, clusters, iterations)

    def learn():
        model = KMeans(
            clusters, init=x[:clusters], n_init=1, max_iter=iterations, tol=0.0, algorithm="lloyd"
        )
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            seconds, _ = timed(lambda: model.fit(x))
        return seconds, inertia(x, model.labels_)

    jobs = {
        "muster": lambda: peer.run("muster"),
        "sklearn": learn,
        "linfa": lambda: peer.run("linfa"),
    }
    time_of, found = medians(rounds, jobs)
    peer.close()
    ours = time_of["muster"]
    rate = 2.0 * n * dims * clusters * (iterations + 1) / ours / 1e9
    print(
        f"k-means N={n} D={dims} k={clusters}, {iterations} iterations: "
        f"muster {1e3 * ours:.3f}, sklearn {1e3 * time_of['sklearn']:.3f}, "
        f"linfa {1e3 * time_of['linfa']:.3f} ms; ratios {time_of['sklearn'] / ours:.1f} and "
        f"{time_of['linfa'] / ours:.1f}; {rate:.1f} GF/s; inertia "
        + ", ".join(f"{name} {result[0]:.12g}" for name, result in found.items())
    )
    gap = abs(found["muster"][0] / found["sklearn"][0] - 1.0)
    return gap <= TOLERANCE["inertia"]


def compare_silhouettes(program, rounds, size):
    n, dims, clusters = size
    x = points(n, dims, clusters)
    peer = Peer(program, x, clusters, 20)
    labels = KMeans(clusters, init=x[:clusters], n_init=1, max_iter=20, tol=0.0).fit(x).labels_

    def learn(metric):
        seconds, value = timed(lambda: silhouette_score(x, labels, metric=metric))
        return seconds, value, 0.0

    jobs = {job: lambda job=job: peer.run(job) for job in ("exact", "squared", "sampled")}
    jobs["sklearn"] = lambda: learn("euclidean")
    jobs["sklearn squared"] = lambda: learn("sqeuclidean")
    time_of, found = medians(rounds, jobs)
    peer.close()
    print(
        f"silhouettes N={n} D={dims} k={clusters}: "
        + ", ".join(f"{name} {1e3 * t:.3f}" for name, t in time_of.items())
        + f" ms; ratios exact {time_of['sklearn'] / time_of['exact']:.1f}, "
        f"squared {time_of['sklearn squared'] / time_of['squared']:.1f}, "
        f"sampled {time_of['sklearn'] / time_of['sampled']:.1f}; "
        + ", ".join(f"{name} {result[0]:.9f}" for name, result in found.items())
        + f", standard error {found['sampled'][1]:.4f}"
    )
    exact = abs(found["exact"][0] - found["sklearn"][0])
    squared = abs(found["squared"][0] - found["sklearn squared"][0])
    sampled = abs(found["sampled"][0] - found["sklearn"][0])
    close = max(exact, squared) <= TOLERANCE["silhouette"]
    return close and sampled <= TOLERANCE["sampled"] * found["sampled"][1] + 1e-8


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("program")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--slow", action="store_true")
    arguments = parser.parse_args()
    print(f"numpy {np.__version__}, scikit-learn {sklearn.__version__}, {platform.machine()}")
    agree = [compare_kmeans(arguments.program, arguments.rounds, size) for size in KMEANS]
    agree += [
        compare_silhouettes(arguments.program, arguments.rounds, size) for size in SILHOUETTES
    ]
    if arguments.slow:
        agree += [compare_silhouettes(arguments.program, 1, size) for size in SLOW_SILHOUETTES]
    if not all(agree):
        sys.exit("results differ")


if __name__ == "__main__":
    main()
