"""The tree of command, cut near its top."""

import numpy
from scipy.sparse.csgraph import connected_components

from .graphs import matrix


def depths(superiors):
    """How many superiors each robot has above it. In a circle, the robot of least number is the top."""
    found = {}
    for robot in range(len(superiors)):
        path = []
        while robot is not None and robot not in found and robot not in path:
            path.append(robot)
            robot = superiors[robot]
        if robot in path:
            circle = path[path.index(robot) :]
            turn = circle.index(min(circle))
            path = path[: path.index(robot)] + circle[turn + 1 :] + circle[: turn + 1]
            found[path.pop()] = 0
        for below in reversed(path):
            above = superiors[below]
            found[below] = 0 if above is None else found[above] + 1
    return [found[robot] for robot in range(len(superiors))]


def sizes(superiors, depth):
    """How many robots each one commands, with itself."""
    found = [1] * len(superiors)
    for robot in sorted(range(len(superiors)), key=lambda robot: -depth[robot]):
        above = superiors[robot]
        if above is not None and depth[above] < depth[robot]:
            found[above] += found[robot]
    return found


def tree(observed):
    """Cuts the ties nearest the top, those of most robots first, until there are as many parts as teams.

    Robots that command nobody and answer to nobody are in no team, and no part.
    """
    if not observed["hierarchy"]:
        return None
    robots, edges = observed["robots"], observed["hierarchy"]
    superiors = [None] * robots
    for superior, robot, _ in edges:
        superiors[robot] = superior
    depth = depths(superiors)
    size = sizes(superiors, depth)
    # The tie of a top in a circle holds nothing together that other ties do not.
    ties = [robot for robot in range(robots) if depth[robot] > 0]
    ties.sort(key=lambda robot: (depth[robot], -size[robot], robot))
    tied = {robot for superior, robot, _ in edges for robot in (superior, robot)}

    def parts(kept):
        graph = matrix(robots, [(superiors[robot], robot, 1.0) for robot in kept])
        return connected_components(graph, directed=False)[1]

    whole = parts(ties)
    count = len(set(whole[list(tied)].tolist()))
    cut = max(observed["teams"] - count, 0)
    labels = parts(ties[cut:])
    _, labels = numpy.unique(labels, return_inverse=True)
    return [int(label) if robot in tied else None for robot, label in enumerate(labels)]
