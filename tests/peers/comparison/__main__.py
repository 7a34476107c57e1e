"""Runs the parts that are asked for, and writes down what they found. See options.py."""

import json
import os
import pathlib
import shlex
import sys
import tempfile
import time

from . import (
    clustering,
    decomposition,
    embeddings,
    goals,
    growth,
    machine,
    options,
    pipeline,
    report,
)
from .progress import note
from .worker import Failure, Worker

HERE = pathlib.Path(__file__).resolve().parent
MANIFEST = HERE.parent / "rust" / "Cargo.toml"


def decompositions(ours, folder, asked, problems):
    for robots in asked.sizes:
        for kind, about in decomposition.KINDS.items():
            for fraction in about["fractions"] if robots <= about["most"] else ():
                yield decomposition.measure(
                    ours, folder, robots, kind, fraction, asked.quick, problems
                )


def packages(ours, folder, asked, target, results, problems):
    """Into `results`: the packages in the environment of their own, or why there are none."""
    sizes = [robots for robots in embeddings.PRONE_SIZES if robots in asked.sizes]
    try:
        with embeddings.start(target) as theirs:
            results["old versions"] = theirs.ask("versions")["versions"]
            results["embeddings"] = [
                embeddings.measure(ours, theirs, folder, robots, problems) for robots in sizes
            ]
    except (Failure, OSError) as error:
        note(f"embeddings: {error}")
        results["embeddings missing"] = str(error)


def clusterings(ours, folder, asked, problems):
    kmeans = clustering.QUICK if asked.quick else clustering.KMEANS
    silhouettes = clustering.QUICK if asked.quick else clustering.SILHOUETTES
    return {
        "kmeans": [clustering.measure_kmeans(ours, folder, size, problems) for size in kmeans],
        "silhouettes": [
            clustering.measure_silhouettes(ours, folder, size, problems) for size in silhouettes
        ],
    }


def run(asked, folder):
    target = pathlib.Path(os.environ["MUSTER_PEERS_TARGET"])
    program = target / "peers-rust" / "release" / "muster-peers"
    problems, begin = [], time.monotonic()
    command = shlex.join(["tests/peers/compare", *sys.argv[1:]])
    results = {"machine": machine.describe(MANIFEST, command), "old versions": {}}
    with Worker(program) as ours:
        results["limits"] = machine.limits(ours)
        results["sharing"] = machine.sharing(ours)
        if "decomposition" in asked.only:
            results["decomposition"] = list(decompositions(ours, folder, asked, problems))
        if "pipeline" in asked.only:
            results["pipeline"] = [
                pipeline.measure(ours, folder, robots, kind, asked.quick, problems)
                for robots in pipeline.SIZES
                if robots in asked.sizes and not (asked.quick and robots > pipeline.SIZES[0])
                for kind in pipeline.KINDS
            ]
        if "embeddings" in asked.only and not asked.quick:
            packages(ours, folder, asked, target, results, problems)
        if "clustering" in asked.only:
            results["clustering"] = clusterings(ours, folder, asked, problems)
    if "growth" in asked.only and not asked.quick:
        results["growth"] = [growth.measure(program, robots) for robots in options.GROWTH]
    results["problems"] = problems
    results["goals"] = goals.reached(results)
    results["seconds"] = time.monotonic() - begin
    return results


def write(results, path):
    from . import plot

    picture = path.with_suffix(".svg")
    plot.draw(results, picture)
    path.write_text(report.whole(results, picture.name), encoding="utf-8")
    data = json.dumps(results, indent=1, ensure_ascii=False)
    path.with_suffix(".json").write_text(data + "\n", encoding="utf-8")


def main():
    asked = options.parse()
    if asked.readme:
        print(report.readme(json.loads(asked.readme.read_text(encoding="utf-8"))))
        return
    try:
        with tempfile.TemporaryDirectory(prefix="muster-compare-") as folder:
            results = run(asked, pathlib.Path(folder))
    except (Failure, ArithmeticError) as error:
        sys.exit(f"the run ends: {error}")
    if asked.out:
        write(results, asked.out)
    print(report.goal_table(results["goals"]) if not asked.out else f"written: {asked.out}")
    if results["problems"]:
        sys.exit("\n".join(["results differ:", *results["problems"]]))


main()
