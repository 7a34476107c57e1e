"""Times of two clocks, medians, and ratios with their spread."""

import statistics
import time
from dataclasses import dataclass


def timed(work):
    """Seconds of this process and of the wall, and what the work returns."""
    wall, cpu = time.perf_counter(), time.process_time()
    result = work()
    cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
    return {"cpu": cpu, "wall": wall}, result


def added(*parts):
    """The sum of times."""
    return {clock: sum(part[clock] for part in parts) for clock in ("cpu", "wall")}


class Times:
    """Times of one job, by the round in which they were taken."""

    def __init__(self):
        self.rounds = {}

    def add(self, number, seconds):
        self.rounds.setdefault(number, []).append(seconds)

    def median(self, clock="cpu"):
        return statistics.median(s[clock] for taken in self.rounds.values() for s in taken)

    def mean(self, clock="cpu"):
        return statistics.fmean(s[clock] for taken in self.rounds.values() for s in taken)

    def by_round(self, clock="cpu"):
        return {
            number: statistics.median(seconds[clock] for seconds in taken)
            for number, taken in self.rounds.items()
        }


@dataclass
class Ratio:
    """How many times longer the peer takes: by the medians, and least and most of any round."""

    value: float
    low: float
    high: float

    def record(self):
        return {"value": self.value, "low": self.low, "high": self.high}


def ratio(peer, ours, clock="cpu"):
    """`clock` "wall" where more than one thread works."""
    peers, own = peer.by_round(clock), ours.by_round(clock)
    ratios = [peers[number] / own[number] for number in peers if number in own]
    return Ratio(peer.median(clock) / ours.median(clock), min(ratios), max(ratios))
