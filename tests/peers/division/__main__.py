"""Divides the situations in a folder: python -m division FOLDER. See tests/experiments, situations/exchange.rs."""

import json
import multiprocessing
import pathlib
import sys
import time

from .leiden import leiden
from .spectral import kmeans, spectral
from .tree import tree


def divide(line):
    observed = json.loads(line)
    without, with_teams = leiden(observed)
    labels = {
        "spectral": spectral(observed),
        "Leiden with k": with_teams,
        "Leiden": without,
        "k-means on positions": kmeans(observed),
        "tree of command": tree(observed),
    }
    return json.dumps({"kind": observed["kind"], "seed": observed["seed"], "labels": labels})


def main():
    folder, begin = pathlib.Path(sys.argv[1]), time.monotonic()
    with (
        open(folder / "observations.jsonl", encoding="utf-8") as lines,
        open(folder / "labels.jsonl", "w", encoding="utf-8") as out,
        multiprocessing.Pool() as pool,
    ):
        for count, labels in enumerate(pool.imap(divide, lines), 1):
            print(labels, file=out)
            if count % 50 == 0:
                seconds = time.monotonic() - begin
                print(f"{seconds:6.0f} s  {count} situations divided", file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
