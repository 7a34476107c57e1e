"""k-means and silhouettes of Muster, scikit-learn and linfa.

All get the same points, the same first centroids and the same number of iterations. Inertias are
those of the labels about their own means. That of linfa is only shown: it counts the centroid before
as one more point of each cluster, so that it takes another way.
"""

import warnings

import numpy as np
from sklearn.cluster import KMeans
from sklearn.metrics import silhouette_score

from .progress import note
from .timing import Times, ratio, timed

# Points, dimensions and clusters.
KMEANS = ((1_000, 16, 8), (10_000, 16, 8), (100_000, 16, 8), (100_000, 32, 50))
SILHOUETTES = ((1_000, 16, 8), (10_000, 16, 8))
QUICK = ((1_000, 16, 8),)
ITERATIONS = 20
ROUNDS = 5
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


def give(ours, folder, size):
    """Makes points, for us and for the worker."""
    x = points(*size)
    path = folder / "points.f64"
    x.tofile(path)
    _, dims, clusters = size
    ours.ask("points", dims=dims, clusters=clusters, iterations=ITERATIONS, **{"from": str(path)})
    return x


def take_turns(jobs):
    """Runs all jobs in turn; times, and the last answer of each. The first round warms caches up."""
    times = {name: Times() for name in jobs}
    found = {}
    for number in range(-1, ROUNDS):
        for name, job in jobs.items():
            seconds, found[name] = job()
            if number >= 0:
                times[name].add(number, seconds)
    return times, found


def asked(ours, do, **fields):
    def job():
        answer = ours.ask(do, **fields)
        return answer["seconds"], answer

    return job


def measure_kmeans(ours, folder, size, problems):
    n, dims, clusters = size
    note(f"k-means: {n:,} points in {dims} dimensions, {clusters} clusters")
    x = give(ours, folder, size)

    def learn():
        model = KMeans(
            clusters, init=x[:clusters], n_init=1, max_iter=ITERATIONS, tol=0.0, algorithm="lloyd"
        )
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            seconds, _ = timed(lambda: model.fit(x))
        return seconds, {"value": inertia(x, model.labels_)}

    jobs = {"ours": asked(ours, "kmeans"), "sklearn": learn, "linfa": asked(ours, "linfa")}
    times, found = take_turns(jobs)
    gap = abs(found["ours"]["value"] / found["sklearn"]["value"] - 1.0)
    if not gap <= TOLERANCE["inertia"]:
        problems.append(f"k-means of {n:,} points: inertias differ by {gap:.1e}")
    seconds = times["ours"].median()
    return {
        "points": n,
        "dims": dims,
        "clusters": clusters,
        "times": {job: taken.median() for job, taken in times.items()},
        "ratios": {job: ratio(times[job], times["ours"]).record() for job in ("sklearn", "linfa")},
        "inertias": {job: answer["value"] for job, answer in found.items()},
        "rate": 2.0 * n * dims * clusters * (ITERATIONS + 1) / seconds,
    }


def measure_silhouettes(ours, folder, size, problems):
    n, dims, clusters = size
    note(f"silhouettes: {n:,} points in {dims} dimensions, {clusters} clusters")
    x = give(ours, folder, size)
    labels = np.array(ours.ask("labels")["labels"])

    def learn(metric):
        def job():
            seconds, value = timed(lambda: silhouette_score(x, labels, metric=metric))
            return seconds, {"value": float(value)}

        return job

    jobs = {form: asked(ours, "silhouette", form=form) for form in ("exact", "squared", "sampled")}
    jobs |= {"sklearn": learn("euclidean"), "sklearn squared": learn("sqeuclidean")}
    times, found = take_turns(jobs)
    pairs = {"exact": "sklearn", "squared": "sklearn squared", "sampled": "sklearn"}
    for own, peer in pairs.items():
        gap = abs(found[own]["value"] - found[peer]["value"])
        allowed = TOLERANCE["silhouette"] + TOLERANCE["sampled"] * found[own]["standard_error"]
        if not gap <= allowed:
            problems.append(f"{own} silhouettes of {n:,} points differ by {gap:.1e}")
    return {
        "points": n,
        "dims": dims,
        "clusters": clusters,
        "times": {job: taken.median() for job, taken in times.items()},
        "ratios": {own: ratio(times[peer], times[own]).record() for own, peer in pairs.items()},
        "values": {job: answer["value"] for job, answer in found.items()},
        "standard_error": found["sampled"]["standard_error"],
        "rate": 3.0 * n * n * dims / times["exact"].median(),
    }
