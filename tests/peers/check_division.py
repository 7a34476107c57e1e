"""What tests/peers/divide does beyond the calls of its libraries, on cases whose answers are known.

Run by a test of tests/experiments, with the packages of requirements.txt.
"""

from division.search import searched
from division.spectral import kmeans, spectral
from division.tree import depths, tree


def orders(robots, teams, *ties):
    return {"robots": robots, "teams": teams, "hierarchy": [[*tie, 1.0] for tie in ties]}


def same(found, wanted):
    """Whether both are one division, whatever the names of its teams."""
    return len(set(zip(found, wanted))) == len(set(found)) == len(set(wanted))


def check_tree():
    # Superiors above each robot; in a circle, the robot of least number is the top.
    assert depths([None, 0, 1, 1]) == [0, 1, 2, 2]
    assert depths([1, 2, 1, 0]) == [1, 0, 1, 2]
    # A headquarters, 0 and 1, and two platoons, whose leaders are 2 and 5; nobody knows robot 8.
    platoons = [(0, 1), (0, 2), (0, 5), (2, 3), (2, 4), (5, 6), (5, 7)]
    found = tree(orders(9, 3, *platoons))
    assert same(found, [0, 0, 1, 1, 1, 2, 2, 2, None]) and found[8] is None, found
    # Two trees are two parts before anything is cut.
    assert same(tree(orders(4, 2, (0, 1), (2, 3))), [0, 0, 1, 1])
    # The tie of the top of a circle is no tie to cut.
    assert same(tree(orders(4, 2, (1, 0), (2, 1), (1, 2), (0, 3))), [0, 1, 1, 0])
    assert tree({"robots": 2, "teams": 2, "hierarchy": None}) is None


def check_search():
    calls = []

    def count(resolution):
        calls.append(resolution)
        return max(1, int(5 * resolution**0.5))

    for wanted in (1, 2, 5, 9, 14):
        assert count(searched(count, wanted)) == wanted
    # Where no resolution gives the number, the nearest counts, after as many steps as are allowed.
    calls.clear()
    assert searched(lambda resolution: 2 if count(resolution) < 5 else 7, 4) < 1
    assert len(calls) == 40


def check_spectral():
    cliques = [range(0, 4), range(4, 9)]
    edges = [[i, j, 1.0] for clique in cliques for i in clique for j in clique if i != j]
    edges.append([0, 4, 0.1])
    positions = [[float(i // 4), 0.0, 0.0] for i in range(8)] + [[1.0, 0.0, 0.0], None]
    observed = {
        "robots": 10,
        "teams": 2,
        "positions": positions,
        "spatial": edges,
        "connectivity": None,
        "hierarchy": [],
    }
    wanted = [0] * 4 + [1] * 5 + [None]
    # Robot 9 has neither an edge nor a position.
    for found in (spectral(observed), kmeans(observed)):
        assert same(found, wanted) and found[9] is None, found
    nothing = {**observed, "positions": None, "spatial": None}
    assert spectral(nothing) is None and kmeans(nothing) is None
    # As many robots as teams.
    two = {**nothing, "robots": 2, "spatial": [[0, 1, 0.5], [1, 0, 0.5]]}
    assert spectral(two) == [0, 1]


check_tree()
check_search()
check_spectral()
