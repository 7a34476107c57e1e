"""Times against the number of robots, as a picture."""

import matplotlib

matplotlib.use("svg")
# Text stays text, so that it can be searched, and the file does not change from run to run by itself.
matplotlib.rcParams.update({"svg.fonttype": "none", "svg.hashsalt": "muster", "font.size": 9})

from matplotlib import pyplot as plt  # noqa: E402

KIND = "smooth"
FRACTION = 0.9
# Job, label, colour and mark; those of Muster in one hue.
LINES = (
    ("literal", "the whole pipeline, dense (faer or LAPACK)", "#7f7f7f", "x"),
    ("gem", "nxt-gem HOPE", "#9467bd", "D"),
    ("scipy default", "scipy splu + ARPACK", "#e8a33d", "v"),
    ("cold scipy", "scipy at its best, to 1e-6", "#d1602e", "s"),
    ("prone", "nodevectors ProNE (not the Katz similarity)", "#b0b0b0", "."),
    ("cold", "Muster, from nothing to 1e-6", "#1b4f8a", "o"),
    ("tick", "Muster, all have moved, to 1e-3", "#3f7fc4", "o"),
    ("event", "Muster, one has moved, U and V to 1e-4", "#86b8ea", "o"),
)


def lines(results):
    """Milliseconds by robots of every line."""
    found = {job: {} for job, *_ in LINES}
    for case in results.get("decomposition", []):
        if (case["kind"], case["fraction"]) == (KIND, FRACTION):
            for job, seconds in case["times"].items():
                if job in found:
                    found[job][case["robots"]] = 1e3 * seconds
    for case in results.get("pipeline", []):
        if case["kind"] == KIND:
            found["literal"][case["robots"]] = 1e3 * case["times"][case["faster"]]
    for case in results.get("embeddings", []):
        for job in ("gem", "prone"):
            if job in case["times"]:
                found[job][case["robots"]] = 1e3 * case["times"][job]
    for case in results.get("growth", []):
        for job in ("cold", "tick"):
            found[job].setdefault(case["robots"], 1e3 * case["times"][job])
    return found


def draw(results, path):
    figure, axes = plt.subplots(figsize=(8.0, 5.2))
    found = lines(results)
    for job, label, colour, mark in LINES:
        if found[job]:
            robots = sorted(found[job])
            axes.loglog(
                robots,
                [found[job][n] for n in robots],
                label=label,
                color=colour,
                marker=mark,
                markersize=5,
                linewidth=2 if job in ("cold", "tick", "event") else 1.2,
            )
    axes.set_xlabel("robots")
    axes.set_ylabel("milliseconds on one thread")
    axes.set_title(f"16 leading triplets of the Katz similarity ({KIND} graphs, αρ = {FRACTION})")
    axes.grid(which="major", color="#dddddd", linewidth=0.6)
    axes.spines[["top", "right"]].set_visible(False)
    if any(found.values()):
        axes.legend(frameon=False, loc="upper left", fontsize=8)
    figure.tight_layout()
    figure.savefig(path, metadata={"Date": None})
    plt.close(figure)
