"""The options of tests/peers/compare. Needs nothing but Python, so that they are checked first."""

import argparse
import pathlib
import re

PARTS = ("decomposition", "pipeline", "embeddings", "clustering", "growth")
SIZES = (200, 500, 1_000, 10_000, 100_000)
GROWTH = (10_000, 100_000, 1_000_000)
QUICK = 1_000
RESULTS = "results.json"

DESCRIPTION = """\
Runs Muster's mathematics and its peers side by side, one thread each, in rounds that take turns,
and prints what the goals are, how Muster's times compare, and what limits them. Every answer that
is timed is checked: residuals are measured by solves of their own, singular values, inertias and
silhouettes must agree. A disagreement ends the run with code 1.

parts:
  decomposition  leading singular triplets without the inverse, and scipy's splu and svds
  pipeline       what one moved robot costs, and eigenvalues, inverse and full decomposition
  embeddings     vectors, and nxt-gem's HOPE and nodevectors' ProNE
  clustering     k-means and silhouettes, and those of scikit-learn and linfa
  growth         10,000 to 1,000,000 robots: time and memory of Muster alone
"""


def sizes(text):
    if not re.fullmatch(r"[0-9]+(,[0-9]+)*", text):
        raise argparse.ArgumentTypeError("robots are numbers separated by commas")
    numbers = tuple(sorted({int(number) for number in text.split(",")}))
    if not 100 <= numbers[0] <= numbers[-1] <= 1_000_000:
        raise argparse.ArgumentTypeError("robots are 100 to 1,000,000")
    return numbers


def parts(text):
    chosen = tuple(text.split(","))
    if unknown := [part for part in chosen if part not in PARTS]:
        raise argparse.ArgumentTypeError(f"no part {unknown[0]}; there are {', '.join(PARTS)}")
    return chosen


def parse(arguments=None):
    parser = argparse.ArgumentParser(
        prog="tests/peers/compare",
        description=DESCRIPTION,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "--quick",
        action="store_true",
        help=f"few rounds of up to {QUICK:,} robots, without the peers that need old libraries: shows "
        "that everything works, and measures nothing well",
    )
    parser.add_argument(
        "--sizes", type=sizes, metavar="N,…", help=f"robots; {','.join(map(str, SIZES))} by default"
    )
    parser.add_argument(
        "--only", type=parts, default=PARTS, metavar="PART,…", help="parts to run; all by default"
    )
    parser.add_argument(
        "--out",
        type=pathlib.Path,
        metavar="FILE.md",
        help="writes the results there as Markdown, a plot of them into FILE.svg, and FILE.json, which "
        "--readme reads",
    )
    parser.add_argument(
        "--readme",
        type=pathlib.Path,
        metavar="FILE.json",
        help="runs nothing, and prints the table of the README from what --out has written",
    )
    options = parser.parse_args(arguments)
    if options.sizes is None:
        options.sizes = tuple(n for n in SIZES if not options.quick or n <= QUICK)
    if options.readme and not options.readme.is_file():
        parser.error(f"--readme: there is no file {options.readme}")
    if options.out and not options.out.resolve().parent.is_dir():
        parser.error(f"--out: there is no folder {options.out.parent}")
    return options


if __name__ == "__main__":
    parse()
