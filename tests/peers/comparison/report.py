"""Results as Markdown: all of it for RESULTS.md, the short table for the README."""

from . import decomposition, work

TIMES = {
    "cold": "from nothing, 1e-6",
    "tick": "all moved, 1e-3",
    "far": f"all moved by {decomposition.FAR}, 1e-3",
    "event": "one moved, U and V, 1e-4",
}
JUMP = {"jump": "one jumped, 1e-4"}


def number(value):
    """Three digits, without powers of ten where people would not use them."""
    if value >= 100:
        return f"{value:,.0f}"
    return f"{value:.3g}"


def times(ratio):
    """A ratio with the least and the most of any round."""
    return f"{number(ratio['value'])} ({number(ratio['low'])}–{number(ratio['high'])})"


def milliseconds(seconds):
    return number(1e3 * seconds)


def table(head, rows):
    lines = ["| " + " | ".join(head) + " |", "|" + " --- |" * len(head)]
    return "\n".join(lines + ["| " + " | ".join(str(cell) for cell in row) + " |" for row in rows])


def verdict(goal):
    if not goal["cases"]:
        return "not measured"
    if goal["reached"]:
        return "reached"
    return f"missed by {100.0 * goal['short']:.0f} % ({goal['worst']})"


def goal_rows(goals):
    for goal in goals:
        wanted = f"{'≤' if goal['most'] else '≥'} {goal['wanted']:,g}{goal['unit']}"
        measured = (
            ", ".join(f"{case['name']}: {spread(case)}" for case in goal["cases"])
            if len(goal["cases"]) > 1
            else "".join(spread(case) for case in goal["cases"])
        )
        yield goal["goal"], wanted, measured or "–", verdict(goal)


def spread(case):
    return number(case["value"]) if case["low"] == case["high"] else times(case)


def goal_table(goals):
    return table(("goal", "wanted", "measured", "verdict"), goal_rows(goals))


def machine_table(results):
    about, limits = results["machine"], results["limits"]
    versions = ", ".join(f"{name} {version}" for name, version in about["versions"].items())
    old = ", ".join(f"{name} {version}" for name, version in results["old versions"].items())
    rows = [
        ("date", f"{about['date']}, load of the machine before: {about['load']:.1f}"),
        ("command", f"`{about['command']}`, {results['seconds'] / 60:.0f} minutes"),
        ("Muster", about["commit"]),
        (
            "processor",
            f"{about['processor']}, {about['cores']} cores, {about['memory'] / 2**30:.0f} GiB",
        ),
        (
            "system",
            f"{about['kernel']}, {about['rustc']}, Python {about['python']}, {about['blas']}",
        ),
        ("peers", versions + (f"; in an environment of their own: {old}" if old else "")),
        (
            "limits, one thread",
            ", ".join(
                f"{name} {value / 1e9:.1f} {limit_unit(name)}"
                for name, value in limits.items()
            ),
        ),
        (
            "limits, two threads against one",
            ", ".join(f"{name} {gain:.2f}×" for name, gain in results["sharing"]["gains"].items())
            + f"; to hand work over to a thread that sleeps, and back: "
            f"{1e6 * results['sharing']['hand over']:.0f} µs",
        ),
    ]
    return table(("", ""), rows)


def limit_unit(name):
    if name == "roots":
        return "·10⁹/s"
    return "GB/s" if name.startswith("triad") else "GF/s"


def decomposition_table(cases):
    head = ("robots", "graph", "c", "job", "Muster ms", "residual", "scipy", "ms", "residual", "ratio")
    rows = []
    for case in cases:
        for job, words in (TIMES | JUMP).items():
            if job not in case["ratios"]:
                continue
            rows.append(
                (
                    f"{case['robots']:,}",
                    case["kind"],
                    case["fraction"],
                    words,
                    milliseconds(case["times"][job]),
                    f"{case['residuals'][job]:.1e} (tol {case['own'][job]:g})",
                    case.get("scipy", "splu, svds"),
                    milliseconds(case["times"][f"{job} scipy"]),
                    f"{case['residuals'][f'{job} scipy']:.1e} (tol {case['theirs'][job]:g})",
                    times(case["ratios"][job]),
                )
            )
    return table(head, rows)


def other_rows(cases):
    for case in cases:
        for job, words in (
            ("event alone", "one moved, certified without U and V; scipy as above"),
            ("event mean", "one moved; of the means instead of the medians"),
            ("scipy default", "from nothing, 1e-6; scipy as it comes (COLAMD, ARPACK, tol 0)"),
            ("threads", "all moved, 1e-3; two threads of Muster against one, by the wall"),
        ):
            if job in case["ratios"]:
                yield (
                    f"{case['robots']:,}",
                    case["kind"],
                    case["fraction"],
                    words,
                    spread(case["ratios"][job]),
                )


def work_rows(results):
    limits = results["limits"]
    # The matrices of one gemm give the most operations; what does not fit a cache comes from memory.
    most = max(limits["gemm faer"], limits["gemm BLAS"])
    cases = [c for c in results.get("decomposition", []) if c["kind"] == "smooth"]
    for case in [*cases, *(c for c in results.get("growth", []) if c["robots"] > 100_000)]:
        for job in ("cold", "tick"):
            if job not in case["searches"]:
                continue
            rounds, seconds = case["searches"][job], case["times"][job]
            done = work.search(case["robots"], case["edges"], case["rank"], rounds)
            rates = done["operations"] / seconds, done["bytes"] / seconds
            yield (
                f"{case['robots']:,}",
                case["fraction"],
                TIMES[job],
                f"{rounds:g}",
                f"{rates[0] / 1e9:.1f} ({100 * rates[0] / most:.0f} %)",
                f"{rates[1] / 1e9:.1f} ({100 * rates[1] / limits['triad DRAM']:.0f} %)",
            )


def pipeline_table(cases):
    head = (
        *("robots", "graph", "faer ms", "LAPACK ms"),
        *("Muster ms", "ratio", "without all pairs", "ratio", "all pairs: GB/s"),
    )
    return table(
        head,
        (
            (
                f"{case['robots']:,}",
                case["kind"],
                milliseconds(case["times"]["faer"]),
                milliseconds(case["times"]["lapack"]),
                milliseconds(case["times"]["all"]),
                times(case["ratios"]["all"]),
                milliseconds(case["times"]["triplets"]),
                times(case["ratios"]["triplets"]),
                # The similarity is read and written once.
                f"{16 * case['robots'] ** 2 / pairs / 1e9:.0f}" if pairs > 0 else "–",
            )
            for case in cases
            for pairs in [case["times"]["all"] - case["times"]["triplets"]]
        ),
    )


def embedding_rows(cases):
    names = {"gem": "nxt-gem HOPE", "prone": "nodevectors ProNE"}
    for case in cases:
        for job, name in names.items():
            robots = f"{case['robots']:,}"
            if job in case["missing"]:
                yield robots, name, f"not run: {case['missing'][job]}", "", "", ""
            elif job in case["times"]:
                residual = f"{case['residual']:.0e}" if job == "gem" else "another similarity"
                ratios = case["ratios"][job]
                yield (
                    robots,
                    name,
                    milliseconds(case["times"][job]),
                    residual,
                    times(ratios["cold"]),
                    times(ratios["tick"]),
                )


def kmeans_table(cases, limits):
    head = (
        *("points", "k", "Muster ms", "GF/s (of a single gemm)"),
        *("scikit-learn ms", "ratio", "linfa ms", "ratio", "inertia of linfa"),
    )
    return table(
        head,
        (
            (
                f"{case['points']:,} × {case['dims']}",
                case["clusters"],
                milliseconds(case["times"]["ours"]),
                f"{number(case['rate'] / 1e9)} ({100 * case['rate'] / limits['single gemm']:.0f} %)",
                milliseconds(case["times"]["sklearn"]),
                times(case["ratios"]["sklearn"]),
                milliseconds(case["times"]["linfa"]),
                times(case["ratios"]["linfa"]),
                f"{100 * (case['inertias']['linfa'] / case['inertias']['ours'] - 1):+.3f} %",
            )
            for case in cases
        ),
    )


def pair_rates(case, form, limits):
    """Operations and square roots per second, where every pair is looked at once, and the share of the limits."""
    if form != "exact":
        return "–", "–"
    per_second = case["points"] * (case["points"] - 1) / 2 / case["times"][form]
    operations = 2 * case["dims"] * per_second
    return (
        f"{operations / 1e9:.1f} ({100 * operations / limits['gemm faer']:.0f} %)",
        f"{per_second:.1e} ({100 * per_second / limits['roots']:.0f} %)",
    )


def silhouette_table(cases, limits):
    head = ("points", "form", "Muster ms", "GF/s", "roots/s", "scikit-learn ms", "ratio", "value")
    peers = {"exact": "sklearn", "squared": "sklearn squared", "sampled": "sklearn"}
    return table(
        head,
        (
            (
                f"{case['points']:,} × {case['dims']}",
                form,
                milliseconds(case["times"][form]),
                *pair_rates(case, form, limits),
                milliseconds(case["times"][peer]),
                times(case["ratios"][form]),
                f"{case['values'][form]:.4f}"
                + (f" ± {case['standard_error']:.4f}" if form == "sampled" else ""),
            )
            for case in cases
            for form, peer in peers.items()
        ),
    )


def growth_table(cases):
    head = ("robots", "edges", "from nothing, 1e-6: s", "all moved, 1e-3: s", "peak of memory")
    return table(
        head,
        (
            (
                f"{case['robots']:,}",
                f"{case['edges']:,}",
                number(case["times"]["cold"]),
                number(case["times"]["tick"]),
                f"{case['peak'] / 1e9:.2f} GB",
            )
            for case in cases
        ),
    )


def whole(results, picture):
    """RESULTS.md."""
    parts = [
        "# Muster and its peers",
        "Written by `tests/peers/compare`, which measures everything again. Times are of the process, on "
        "one thread unless stated otherwise, medians over rounds in which both sides alternate on "
        "the same input. Ratios are how many times longer the peer takes: of the medians, and in "
        "brackets the least and the most of any round.",
        machine_table(results),
        "## Goals",
        "A goal is reached when the slowest of the cases reaches it.",
        goal_table(results["goals"]),
    ]
    if results["problems"]:
        parts += ["## Disagreements", "\n".join(f"- {problem}" for problem in results["problems"])]
    if picture:
        parts.append(f"![Times against the number of robots]({picture})")
    parts += decomposition_parts(results)
    if cases := results.get("pipeline"):
        parts += [
            "## One robot has moved: the whole pipeline",
            "The peers take all eigenvalues, the inverse and the full decomposition of S. Muster bounds "
            "the radius, brings the similarity of all pairs up to date, and certifies the leading "
            "triplets to 1e-4; *without all pairs* leaves the second out, as a fleet does without gets "
            "of pairs. c = 0.9.",
            pipeline_table(cases),
        ]
    if cases := results.get("embeddings"):
        head = ("robots", "peer", "ms", "residual", "against Muster from nothing", "all moved")
        parts += [
            "## Packages for embeddings",
            "On smooth graphs with c = 0.9. HOPE factorises the same similarity, by a dense inverse; "
            "ProNE another one, so that only its time is comparable.",
            table(head, embedding_rows(cases)),
        ]
    elif reason := results.get("embeddings missing"):
        parts += ["## Packages for embeddings", f"nxt-gem and nodevectors: {reason}"]
    if cases := results.get("clustering"):
        parts += [
            "## k-means",
            "20 iterations from the same centroids, to the same inertia as scikit-learn. linfa counts "
            "the centroid before as one more point of each cluster, so that its way is another one. Operations are "
            "two for each coordinate of each point and centroid.",
            kmeans_table(cases["kmeans"], results["limits"]),
            "## Silhouettes",
            "In brackets: the share of the fastest dense product, and of the square roots that one thread takes "
            "when it does nothing else. The *exact* form takes both, one after the other in each register.",
            silhouette_table(cases["silhouettes"], results["limits"]),
        ]
    if cases := results.get("growth"):
        parts += [
            "## Large fleets",
            "Muster alone on smooth graphs with c = 0.9, each size in a process of its own. The peak is "
            "that of resident memory from when the graph is there.",
            growth_table(cases),
        ]
    return "\n\n".join(parts) + "\n"


def decomposition_parts(results):
    cases = results.get("decomposition")
    if not cases:
        return []
    others = list(other_rows(cases))
    return [
        "## Leading singular triplets",
        "The 16 leading triplets of the Katz similarity with αρ = c. *knn*: 8 nearest neighbours, radio "
        "links and an 8-ary tree; *smooth*: a kernel that falls to zero at its radius, and the tree; "
        "*undirected*: the kernel alone; *apart*: the kernel, and a tree of commands that has nothing to do "
        "with places, which fills SuperLU's factors. "
        f"*All moved*: every robot goes {decomposition.TICK} mean spacings ahead and turns by up to 6°, "
        f"and Muster begins with the frame before; also at {decomposition.FAR} spacings. "
        "*One moved*: any robot goes as far as in a tick, *one jumped*: "
        f"{decomposition.JUMP} mean spacings. Muster's time is that of the function that the "
        "services call (`LeadingTriplets::advance`), which finds the rows of the graph that differ, until "
        "singular values, a certified residual, U and V are there. scipy is "
        '`splu(permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})` and '
        '`svds(solver="propack")`, with the matrix I − αA ready, while Muster begins with the graph. Of '
        "SuperLU that way counts which is faster on the first graph: *panels*, as it comes, or *columns*, "
        "with `relax=1, panel_size=1, diag_pivot_thresh=0`. For undirected graphs `eigsh` of A counts where "
        "it is faster than either.",
        "Residuals are max ‖Sᵀu − σv‖, ‖Sv − σu‖ relative to σ₁, measured by refined solves, the largest "
        "of all rounds. scipy's time is that of the loosest tolerance with which it gets there on the "
        "very graph and misses no singular value; the last one is shown.",
        decomposition_table(cases),
        *([table(("robots", "graph", "c", "", "ratio"), others)] if others else []),
        "### What limits the search",
        "Operations and bytes are estimates from above, as if every direction were searched for until "
        "the last round; in brackets the share of the fastest dense product and of the memory's "
        "triad. Fleets that fit a cache may pass the latter.",
        table(("robots", "c", "job", "rounds", "GF/s", "GB/s"), work_rows(results)),
    ]


def readme(results):
    """The short table: one row per job and size, the range over all fleets."""
    rows = []
    for job, words in TIMES.items():
        cases = results.get("decomposition", [])
        for robots in sorted({case["robots"] for case in cases}):
            own = [c for c in cases if c["robots"] == robots and job in c["times"]]
            if not own:
                continue
            rows.append(
                (
                    f"{robots:,} robots, {words}",
                    extent([1e3 * case["times"][job] for case in own]),
                    extent([1e3 * case["times"][f"{job} scipy"] for case in own]),
                    extent([case["ratios"][job]["value"] for case in own]) + "×",
                )
            )
    for case in results.get("pipeline", []):
        if case["kind"] == "smooth":
            rows.append(
                (
                    f"{case['robots']:,} robots, one moved, with the similarity of all pairs",
                    milliseconds(case["times"]["all"]),
                    f"{milliseconds(case['times'][case['faster']])} (dense, {case['faster']})",
                    f"{number(case['ratios']['all']['value'])}×",
                )
            )
    for case in results.get("embeddings", []):
        if "gem" in case["times"]:
            rows.append(
                (
                    f"{case['robots']:,} robots, from nothing",
                    milliseconds(case["times"]["cold"]),
                    f"{milliseconds(case['times']['gem'])} (nxt-gem HOPE)",
                    f"{number(case['ratios']['gem']['cold']['value'])}×",
                )
            )
    for case in results.get("clustering", {}).get("kmeans", []):
        size = f"{case['points']:,} × {case['dims']}, k = {case['clusters']}"
        for peer, name in (("sklearn", "scikit-learn"), ("linfa", "linfa")):
            rows.append(
                (
                    f"k-means, {size}",
                    milliseconds(case["times"]["ours"]),
                    f"{milliseconds(case['times'][peer])} ({name})",
                    f"{number(case['ratios'][peer]['value'])}×",
                )
            )
    for case in results.get("clustering", {}).get("silhouettes", []):
        rows.append(
            (
                f"exact silhouettes, {case['points']:,} × {case['dims']}",
                milliseconds(case["times"]["exact"]),
                f"{milliseconds(case['times']['sklearn'])} (scikit-learn)",
                f"{number(case['ratios']['exact']['value'])}×",
            )
        )
    for case in results.get("growth", []):
        if case["robots"] > 100_000:
            peak = f"{case['peak'] / 1e9:.1f} GB"
            words = f"{case['robots']:,} robots, {TIMES['cold']}, in {peak}"
            rows.append((words, milliseconds(case["times"]["cold"]), "–", "–"))
    return table(("", "Muster ms", "scipy's best ms, or another", "ratio"), rows)


def extent(values):
    low, high = number(min(values)), number(max(values))
    return low if low == high else f"{low}–{high}"
