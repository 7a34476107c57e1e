"""Leading singular triplets of the Katz similarity: Muster and scipy at its best.

Every case is one fleet, one kind of graph and one product of decay and spectral radius. In every
round robots move, Muster solves the frames, cold and from the frame before, and scipy solves the
same graphs. What counts is the time of the loosest setting whose answer has a *measured* residual
within what is asked for, and misses no singular value; scipy's is found for every single graph.
"""

import itertools
import statistics
from dataclasses import dataclass, field

from . import katz
from .progress import note
from .timing import Times, added, ratio, timed
from .worker import Failure

RANK = 16
FRACTIONS = (0.9, 0.5)
# Graphs, with the products of decay and radius, and the most robots. Those of which robots command
# others wherever they are fill the factors of SuperLU.
KINDS = {
    "knn": {"fractions": FRACTIONS, "most": 1_000_000},
    "smooth": {"fractions": FRACTIONS, "most": 1_000_000},
    "undirected": {"fractions": FRACTIONS, "most": 1_000_000},
    "apart": {"fractions": FRACTIONS[:1], "most": 10_000},
}
# The kind whose S is symmetric, for which scipy also finds eigenvalues of A.
SYMMETRIC = "undirected"

# Residuals that are asked for, relative to the largest singular value.
TARGETS = {"cold": 1e-6, "tick": 1e-3, "far": 1e-3, "event": 1e-4, "jump": 1e-4}
# How far robots go in mean spacings: all of them in a tick, any one in an event, in which poses come one
# by one, and any one in a jump, after which a robot reports again.
TICK = 0.004
FAR = 0.05
EVENT = TICK
JUMP = 25 * TICK
# What is done on the graphs of each fleet, and for how many robots at most.
SITES = {
    "tick": {"jobs": ("cold", "tick"), "spacings": TICK, "most": 1_000_000},
    "far": {"jobs": ("far",), "spacings": FAR, "most": 100_000},
    "event": {"jobs": ("event",), "spacings": EVENT, "most": 1_000_000},
    "jump": {"jobs": ("jump",), "spacings": JUMP, "most": 10_000},
}
# Where all robots move.
ALL_MOVE = ("tick", "far")
# Tolerances of Muster relative to the target, and those of PROPACK, from loose to tight.
OURS = (1.0, 0.7, 0.5, 0.35, 0.25, 0.1)
THEIRS = (1.0, 0.3, 0.1, 0.03, 1e-2, 3e-3, 1e-3, 3e-4, 1e-4, 1e-5, 1e-6, 1e-8, 0.0)
# Where the search for PROPACK's begins.
BEGIN = {"cold": THEIRS.index(1e-2), "tick": THEIRS.index(0.1), "event": THEIRS.index(0.03)}
BEGIN["jump"], BEGIN["far"] = BEGIN["event"], BEGIN["tick"]
# Frames of Muster before anything is measured: two of history, and some to settle.
WARM = 4
# By how much singular values may differ beyond what the two residuals allow (Weyl).
ROUNDING = 1e-9
# Up to this many robots scipy is also run as it comes; from this many, Muster on two threads.
DEFAULTS_UP_TO = 10_000
THREADS_FROM = 10_000


def plan(robots, quick):
    """Rounds, frames of Muster in a round, and runs of the others on each graph."""
    if quick:
        return {"rounds": 2, "frames": 3, "runs": 1}
    if robots <= 1_000:
        return {"rounds": 11, "frames": 6, "runs": 3}
    if robots <= 10_000:
        return {"rounds": 7, "frames": 4, "runs": 1}
    return {"rounds": 3, "frames": 4, "runs": 1}


@dataclass
class Case:
    """One kind of fleet in the worker, the files that pass between, and what was found."""

    ours: object
    folder: object
    robots: int
    kind: str
    fraction: float
    problems: list
    edges: int = 0
    alpha: dict = field(default_factory=dict)
    # How scipy does best, once it was tried: the way of SuperLU, and by eigenvalues of A or not.
    way: str = ""
    by_eigenvalues: bool = False
    own: dict = field(default_factory=lambda: dict.fromkeys(TARGETS, 0))
    theirs: dict = field(default_factory=lambda: dict(BEGIN))
    times: dict = field(default_factory=dict)
    residuals: dict = field(default_factory=dict)
    searches: dict = field(default_factory=lambda: {job: [] for job in TARGETS})

    @property
    def name(self):
        return f"{self.robots:,} robots, {self.kind}, c = {self.fraction}"

    def add(self, job, number, seconds):
        self.times.setdefault(job, Times()).add(number, seconds)

    def saw(self, job, residual):
        self.residuals[job] = max(self.residuals.get(job, 0.0), residual)

    @property
    def sites(self):
        return [site for site, about in SITES.items() if self.robots <= about["most"]]

    def fleets(self):
        """A fleet for each way to move."""
        for site in self.sites:
            about = self.ours.ask(
                "fleet",
                site=site,
                robots=self.robots,
                graph=self.kind,
                fraction=self.fraction,
                seed=7,
            )
            self.alpha[site], self.edges = about["alpha"], about["edges"]
        for _ in range(WARM):
            for site in self.sites:
                self.advance(site)
                self.solve(site, site)

    def advance(self, site):
        spacings = SITES[site]["spacings"]
        about = self.ours.ask("advance", site=site, spacings=spacings, all=site in ALL_MOVE)
        self.alpha[site] = about["alpha"]

    def system(self, site):
        """The graph of the moment, and its matrix M."""
        path = self.folder / "graph"
        self.ours.ask("write_graph", site=site, to=str(path))
        graph = katz.read_graph(path, self.robots)
        return graph, katz.katz_matrix(graph, self.alpha[site])

    def try_ways(self, adjacency, matrix):
        """Finds out how scipy does best, on the first graph."""
        taken, tolerance = {}, THEIRS[BEGIN["cold"]]
        for way in katz.FACTORS:
            seconds, _ = timed(
                lambda way=way: katz.leading(
                    katz.factorise(matrix, way), RANK, tolerance=tolerance
                )
            )
            taken[way] = seconds["cpu"]
        self.way = min(taken, key=taken.get)
        if self.kind == SYMMETRIC:
            seconds, _ = timed(
                lambda: katz.leading_symmetric(adjacency, self.alpha["tick"], RANK, tolerance)
            )
            self.by_eigenvalues = seconds["cpu"] < taken[self.way]
        ways = ", ".join(f"{way} {1e3 * seconds:.3g} ms" for way, seconds in taken.items())
        note(f"{self.name}: scipy by {ways}; eigenvalues of A: {self.by_eigenvalues}")

    def solve(self, site, job, stream=None, threads=1, want=False):
        """One solve by Muster for a job; triplets only if they are wanted."""
        path = self.folder / "triplets"
        answer = self.ours.ask(
            "solve",
            site=site,
            stream=None if job == "cold" else stream or job,
            rank=RANK,
            tolerance=TARGETS[job] * OURS[self.own[job]],
            threads=threads,
            to=str(path) if want else None,
        )
        if not answer["converged"]:
            self.problems.append(f"{self.name}, {job}: Muster did not reach its tolerance")
        return answer, katz.read_triplets(path, self.robots) if want else None


def measure(ours, folder, robots, kind, fraction, quick, problems):
    """All jobs of one case, as a record of plain numbers."""
    case = Case(ours, folder, robots, kind, fraction, problems)
    steps = plan(robots, quick)
    note(f"{case.name}: fleets")
    case.fleets()
    has_threads = robots >= THREADS_FROM and supports_threads(case)
    for number in itertools.count():
        # Rounds that miss the residual do not count, so that there may be some more of them.
        if number >= steps["rounds"] and all(site in case.times for site in case.sites):
            return record(case)
        note(f"{case.name}: round {number + 1} of {steps['rounds']}")
        taken, last = frames(case, steps["frames"], has_threads)
        for site in case.sites:
            adjacency, matrix = case.system(site)
            if not case.way:
                case.try_ways(adjacency, matrix)
            graph = Graph(case, site, adjacency, matrix, number, steps["runs"])
            settled(case, number, site, taken, graph.check.residual(last[site]))
            if site == "tick":
                graph.reference(*cold(case, steps["runs"], number, graph.check))
            else:
                graph.reference(last[site][1], graph.check.residual(last[site]))
            for job in SITES[site]["jobs"]:
                graph.reach(job)
            if site == "tick" and not quick and robots <= DEFAULTS_UP_TO:
                seconds, _ = timed(lambda matrix=matrix: katz.by_default(matrix, RANK))
                case.add("scipy default", number, seconds)


def supports_threads(case):
    try:
        case.solve("tick", "tick", stream="threads", threads=2)
    except Failure as error:
        note(f"{case.name}: two threads: {error}")
        return False
    return True


def spent(answer):
    """Time of a solve, with its vectors."""
    return added(answer["seconds"], answer["vectors"])


def frames(case, count, has_threads):
    """Some frames by Muster alone: times by job, and the triplets of the last ones."""
    taken = {job: [] for job in (*case.sites, "event alone", "tick 2 threads")}
    last = {}
    for frame in range(count):
        for site in case.sites:
            case.advance(site)
            answer, last[site] = case.solve(site, site, want=frame == count - 1)
            taken[site].append((answer["rounds"], spent(answer)))
            if site == "event":
                taken["event alone"].append((answer["rounds"], answer["seconds"]))
        if has_threads:
            answer, _ = case.solve("tick", "tick", stream="threads", threads=2)
            taken["tick 2 threads"].append((answer["rounds"], spent(answer)))
    return taken, last


def settled(case, number, site, taken, residual):
    """Counts the frames of a round if the last one has the residual, and tightens if it has not."""
    if residual > TARGETS[site] and tighten(case, site):
        return
    case.saw(site, residual)
    for job, frames_taken in taken.items():
        if job.split()[0] == site:
            for _, seconds in frames_taken:
                case.add(job, number, seconds)
    case.searches[site] += [rounds for rounds, _ in taken[site]]


def tighten(case, job):
    """Takes Muster's next tolerance, if there is one."""
    if case.own[job] + 1 == len(OURS):
        case.problems.append(f"{case.name}, {job}: Muster does not reach {TARGETS[job]:g}")
        return False
    case.own[job] += 1
    return True


def cold(case, runs, number, check):
    """Muster without a frame before: singular values, and their residual."""
    while True:
        solved = [case.solve("tick", "cold", want=True) for _ in range(runs)]
        triplets = solved[-1][1]
        residual = check.residual(triplets)
        if residual <= TARGETS["cold"] or not tighten(case, "cold"):
            break
    case.saw("cold", residual)
    for answer, _ in solved:
        case.add("cold", number, spent(answer))
        case.searches["cold"].append(answer["rounds"])
    return triplets[1], residual


class Graph:
    """scipy on one graph."""

    def __init__(self, case, site, adjacency, matrix, number, runs):
        self.case, self.number, self.runs = case, number, runs
        self.adjacency, self.alpha = adjacency, case.alpha[site]
        solved = [timed(lambda: katz.factorise(matrix, case.way)) for _ in range(runs)]
        self.seconds = [seconds for seconds, _ in solved]
        self.factors = solved[-1][1]
        self.check = katz.ResidualCheck(matrix, self.factors)
        self.known = {}

    def reference(self, sigma, residual):
        """What Muster found; no peer may fall short of it."""
        self.sigma, self.allowed = sigma, residual + ROUNDING

    def answer(self, place):
        """Times, residual, and whether singular values are missing, with one setting."""
        if place not in self.known:
            solved = [timed(lambda: self.leading(THEIRS[place])) for _ in range(self.runs)]
            sums = [
                second if self.case.by_eigenvalues else added(first, second)
                for first, (second, _) in zip(self.seconds, solved, strict=True)
            ]
            triplets = solved[-1][1]
            residual = self.check.residual(triplets)
            gap = (triplets[1] - self.sigma) / self.sigma[0]
            allowed = self.allowed + residual
            if gap.max() > allowed:
                self.case.problems.append(
                    f"{self.case.name}: scipy's singular values are larger by {gap.max():.1e}"
                )
            self.known[place] = sums, residual, gap.min() < -allowed
        return self.known[place]

    def leading(self, tolerance):
        if self.case.by_eigenvalues:
            return katz.leading_symmetric(self.adjacency, self.alpha, RANK, tolerance)
        return katz.leading(self.factors, RANK, tolerance=tolerance)

    def is_enough(self, place, target):
        _, residual, misses = self.answer(place)
        return residual <= target and not misses

    def reach(self, job):
        """Times the loosest setting that does the job, from the one that did it last."""
        case, target = self.case, TARGETS[job]
        place = case.theirs[job]
        if self.is_enough(place, target):
            while place > 0 and self.is_enough(place - 1, target):
                place -= 1
        else:
            while not self.is_enough(place, target) and place + 1 < len(THEIRS):
                place += 1
            if not self.is_enough(place, target):
                case.problems.append(f"{case.name}, {job}: scipy and Muster do not agree")
        case.theirs[job] = place
        sums, residual, _ = self.answer(place)
        case.saw(f"{job} scipy", residual)
        for seconds in sums:
            case.add(f"{job} scipy", self.number, seconds)


def record(case):
    jobs = [job for job in TARGETS if job in case.times]
    ratios = {job: ratio(case.times[f"{job} scipy"], case.times[job]).record() for job in jobs}
    ratios["event alone"] = ratio(case.times["event scipy"], case.times["event alone"]).record()
    if "scipy default" in case.times:
        ratios["scipy default"] = ratio(case.times["scipy default"], case.times["cold"]).record()
    if "tick 2 threads" in case.times:
        threads = ratio(case.times["tick"], case.times["tick 2 threads"], "wall")
        ratios["threads"] = threads.record()
    # A frame of many takes a search, which the median does not show.
    mean = case.times["event scipy"].mean() / case.times["event"].mean()
    ratios["event mean"] = {"value": mean, "low": mean, "high": mean}
    return {
        "robots": case.robots,
        "kind": case.kind,
        "fraction": case.fraction,
        "rank": RANK,
        "scipy": "eigsh(A)" if case.by_eigenvalues else f"splu ({case.way}), svds",
        "edges": case.edges,
        "times": {job: taken.median() for job, taken in case.times.items()},
        "ratios": ratios,
        "residuals": case.residuals,
        "own": {job: TARGETS[job] * OURS[place] for job, place in case.own.items()},
        "theirs": {job: THEIRS[place] for job, place in case.theirs.items()},
        "searches": {job: statistics.median(case.searches[job]) for job in jobs},
    }
