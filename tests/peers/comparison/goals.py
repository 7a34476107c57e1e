"""What is to be reached, and whether it is."""

from .growth import exponent

# (job, robots, least ratio), of the slowest fleet of that size.
DECOMPOSITION = (
    ("cold", 200, 1.0),
    ("cold", 500, 1.0),
    ("cold", 1_000, 1.5),
    ("cold", 10_000, 2.5),
    ("cold", 100_000, 4.0),
    ("tick", 1_000, 8.0),
    ("tick", 10_000, 8.0),
    ("tick", 100_000, 15.0),
    ("far", 1_000, 1.0),
    ("far", 10_000, 1.0),
    ("far", 100_000, 1.0),
    ("threads", 10_000, 1.7),
    ("threads", 100_000, 1.7),
    ("event", 1_000, 50.0),
    ("event", 10_000, 500.0),
)
WORDS = {
    "cold": "{robots:,} robots, from nothing to 1e-6, against scipy's best",
    "tick": "{robots:,} robots, all have moved, to 1e-3, against scipy's best",
    "threads": "{robots:,} robots, all have moved, two threads against one",
    "far": "{robots:,} robots, all have moved by 0.05 spacings, to 1e-3, against scipy's best",
    "event": "{robots:,} robots, one has moved, U and V to 1e-4, against scipy's best",
}
PIPELINE = {200: 100.0, 1_000: 1_000.0}
HOPE = {"cold": 25.0, "tick": 80.0}
KMEANS = {"sklearn": 4.0, "linfa": 10.0}
SILHOUETTE = (10_000, 30.0)
EXPONENT = 1.2
MEMORY = {100_000: 0.7e9, 1_000_000: 7e9}


def goal(words, wanted, cases, *, most=False, unit="×"):
    """One goal: `cases` are pairs of a name and a ratio. `most` if it is to be at most `wanted`."""
    if not cases:
        return {"goal": words, "wanted": wanted, "cases": [], "unit": unit, "most": most}
    worst = (max if most else min)(cases, key=lambda case: case[1]["value"])
    value = worst[1]["value"]
    short = (value / wanted - 1.0) if most else (1.0 - value / wanted)
    return {
        "goal": words,
        "wanted": wanted,
        "most": most,
        "unit": unit,
        "cases": [{"name": name, **ratio} for name, ratio in cases],
        "worst": worst[0],
        "reached": short <= 0.0,
        "short": max(short, 0.0),
    }


def reached(results):
    """All goals, those that were not measured without cases."""
    found = []
    cases = results.get("decomposition", [])
    for job, robots, wanted in DECOMPOSITION:
        ratios = [
            (f"{case['kind']} {case['fraction']}", case["ratios"][job])
            for case in cases
            if case["robots"] == robots and job in case["ratios"]
        ]
        found.append(goal(WORDS[job].format(robots=robots), wanted, ratios))
    for robots, wanted in PIPELINE.items():
        ratios = [
            (case["kind"], case["ratios"]["all"])
            for case in results.get("pipeline", [])
            if case["robots"] == robots
        ]
        words = f"{robots:,} robots, one has moved, against the whole pipeline"
        found.append(goal(words, wanted, ratios))
    for job, wanted in HOPE.items():
        ratios = [
            (case["kind"], case["ratios"]["gem"][job])
            for case in results.get("embeddings", [])
            if "gem" in case["ratios"]
        ]
        words = {"cold": "from nothing", "tick": "all have moved"}[job]
        found.append(goal(f"1,000 robots, {words}, against nxt-gem's HOPE", wanted, ratios))
    clustering = results.get("clustering", {"kmeans": [], "silhouettes": []})
    for peer, wanted in KMEANS.items():
        ratios = [
            (f"{case['points']:,} × {case['dims']}, k = {case['clusters']}", case["ratios"][peer])
            for case in clustering["kmeans"]
        ]
        name = {"sklearn": "scikit-learn", "linfa": "linfa"}[peer]
        found.append(goal(f"k-means, against {name}", wanted, ratios))
    points, wanted = SILHOUETTE
    ratios = [
        (f"{case['points']:,} × {case['dims']}", case["ratios"]["exact"])
        for case in clustering["silhouettes"]
        if case["points"] == points
    ]
    words = f"exact silhouettes of {points:,} points, against scikit-learn"
    found.append(goal(words, wanted, ratios))
    alone = results.get("growth", [])
    known = [plain("10⁴ to 10⁶ robots", exponent(alone))] if len(alone) > 1 else []
    words = "growth of the time from 10⁴ to 10⁶ robots, exponent"
    found.append(goal(words, EXPONENT, known, most=True, unit=""))
    for robots, wanted in MEMORY.items():
        peaks = [plain("smooth", c["peak"] / 1e9) for c in alone if c["robots"] == robots]
        words = f"memory at {robots:,} robots"
        found.append(goal(words, wanted / 1e9, peaks, most=True, unit=" GB"))
    return found


def plain(name, value):
    return name, {"value": value, "low": value, "high": value}
