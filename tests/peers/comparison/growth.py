"""Time and memory of Muster alone as fleets grow. Each size has a process of its own."""

import math
import statistics

from .decomposition import RANK, TARGETS, TICK, spent
from .progress import note
from .worker import Failure, Worker

KIND = "smooth"
FRACTION = 0.9
RUNS = {10_000: 5, 100_000: 3, 1_000_000: 1}


def measure(program, robots):
    with Worker(program) as worker:
        note(f"{robots:,} robots alone")
        site = {"site": "alone"}
        about = worker.ask(
            "fleet", robots=robots, graph=KIND, fraction=FRACTION, seed=7, **site
        )
        # The peak counts from here: the graph is there, and what it was made from is gone. Where the
        # system does not let a process forget, it counts from the start, and is larger.
        try:
            worker.ask("forget_peak")
        except Failure as error:
            note(f"{robots:,} robots alone: {error}")
        seconds, rounds = [], []
        for _ in range(RUNS.get(robots, 1)):
            answer = solve(worker, None, TARGETS["cold"])
            seconds.append(spent("cold", answer)["cpu"])
            rounds.append(answer["rounds"])
        cold_peak = worker.ask("peak")["value"]
        ticks = []
        for _ in range(4):
            worker.ask("advance", spacings=TICK, all=True, **site)
            ticks.append(spent("tick", solve(worker, "tick", TARGETS["tick"]))["cpu"])
        return {
            "robots": robots,
            "edges": about["edges"],
            "times": {
                "cold": statistics.median(seconds),
                # Those with two frames of history.
                "tick": statistics.median(ticks[2:]),
            },
            "searches": {"cold": statistics.median(rounds)},
            "peak": cold_peak,
            "kind": KIND,
            "fraction": FRACTION,
            "rank": RANK,
        }


def solve(worker, stream, tolerance):
    answer = worker.ask(
        "solve", site="alone", stream=stream, rank=RANK, tolerance=tolerance, threads=1, to=None
    )
    if not answer["converged"]:
        raise ArithmeticError("Muster did not reach the tolerance")
    return answer


def exponent(records):
    """log(time ratio) / log(size ratio) between the smallest and the largest fleet."""
    first, last = records[0], records[-1]
    times = last["times"]["cold"] / first["times"]["cold"]
    return math.log(times) / math.log(last["robots"] / first["robots"])
