"""The options of tests/peers/divide. Needs nothing but Python, so that they are checked first."""

import argparse
import pathlib

KINDS = ("chosen", "once", "all")
SEEDS = 10

DESCRIPTION = """\
Divides kinds of fleets whose true teams are known by Muster with its defaults, by the paper's
method, and by spectral clustering, multiplex Leiden, k-means on positions and the tree of command,
all on the same observations, and writes which robots are in the right team.

kinds:
  chosen  those that defaults may be chosen on
  once    those that are looked at once, when all is chosen
  all     both
"""


def count(text):
    number = int(text)
    if number < 0:
        raise argparse.ArgumentTypeError("must not be negative")
    return number


def parse(arguments=None):
    parser = argparse.ArgumentParser(
        prog="tests/peers/divide",
        description=DESCRIPTION,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "--kinds", choices=KINDS, default=KINDS[0], help=f"which kinds; {KINDS[0]} by default"
    )
    parser.add_argument(
        "--seeds",
        type=count,
        default=SEEDS,
        metavar="N",
        help=f"seeds of each kind; {SEEDS} by default, and three at most of the largest kinds",
    )
    parser.add_argument(
        "--first", type=count, metavar="SEED", help="the first seed; by default that of the list"
    )
    parser.add_argument(
        "--out",
        type=pathlib.Path,
        metavar="FOLDER",
        help="writes RESULTS.md, results.csv and a plot there; without it the page goes to standard output",
    )
    options = parser.parse_args(arguments)
    if not 1 <= options.seeds <= 1000:
        parser.error("--seeds: must be 1 to 1,000")
    return options


if __name__ == "__main__":
    asked = parse()
    words = [asked.out or "-", "--kinds", asked.kinds, "--seeds", asked.seeds]
    if asked.first is not None:
        words += ["--first", asked.first]
    print(*words, sep="\n")
