"""nxt-gem's HOPE and nodevectors' ProNE, in the environment with the old libraries that they need.

Answers one line of JSON on standard input with another, as the Rust program does. Imports nothing of
the rest of this folder, which runs with other libraries.
"""

import contextlib
import importlib.metadata
import json
import os
import pathlib
import sys
import time

import numpy as np
import scipy.sparse as sp

STATE = {}


def timed(work):
    wall, cpu = time.perf_counter(), time.process_time()
    result = work()
    cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
    return {"cpu": cpu, "wall": wall}, result


def versions(_):
    names = ("nxt-gem", "nodevectors", "networkx", "numpy", "scipy", "numba")
    found = {}
    for name in names:
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            found[name] = importlib.metadata.version(name)
    return {"versions": found}


def load(command):
    path, robots = pathlib.Path(command["from"]), command["robots"]
    starts = np.fromfile(path.with_suffix(".starts"), dtype="<u4").astype(np.int32)
    columns = np.fromfile(path.with_suffix(".columns"), dtype="<u4").astype(np.int32)
    weights = np.fromfile(path.with_suffix(".weights"), dtype="<f8")
    STATE["graph"] = sp.csr_matrix((weights, columns, starts), shape=(robots, robots))
    return {}


def gem(command):
    """Writes U, sigma and V of the embedding [U sqrt(sigma), V sqrt(sigma)]."""
    import networkx
    from gem.embedding.hope import HOPE

    graph = networkx.from_scipy_sparse_array(STATE["graph"], create_using=networkx.DiGraph)
    model = HOPE(d=2 * command["rank"], beta=command["alpha"])
    seconds, found = timed(lambda: model.learn_embedding(graph=graph, is_weighted=True, no_python=True))
    x = found[0] if isinstance(found, tuple) else found
    left, right = np.hsplit(np.asarray(x, dtype=np.float64), 2)
    sigma = np.linalg.norm(left, axis=0) ** 2
    order = np.argsort(sigma)[::-1]
    path = pathlib.Path(command["to"])
    sigma[order].tofile(path.with_suffix(".sigma"))
    for side, ending in ((left, ".u"), (right, ".v")):
        side = side[:, order]
        np.ascontiguousarray(side / np.linalg.norm(side, axis=0)).tofile(path.with_suffix(ending))
    return {"seconds": seconds}


def prone(command):
    from csrgraph import csrgraph
    from nodevectors import ProNE

    graph = csrgraph(STATE["graph"])
    model = ProNE(n_components=command["dims"], verbose=False)
    seconds, _ = timed(lambda: model.fit_transform(graph))
    return {"seconds": seconds}


def main():
    commands = {"versions": versions, "load": load, "gem": gem, "prone": prone}
    # What the libraries print must not stand among the answers.
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    for line in sys.stdin:
        command = json.loads(line)
        try:
            answer = commands[command["do"]](command)
        except Exception as error:  # The reason is shown in the table.
            answer = {"error": f"{type(error).__name__}: {error}"}
        print(json.dumps(answer), file=answers, flush=True)


main()
