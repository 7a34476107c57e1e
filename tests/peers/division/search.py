"""The search for a resolution that gives a number of teams."""

STEPS = 40
# How much finer or coarser the next resolution is while the number lies beyond all that were found.
STRIDE = 2.0


def searched(count, wanted):
    """The resolution for which `count` gives the number that is wanted, or comes nearest to it.

    The number grows with the resolution, by and large: the search doubles or halves it until the number lies
    between two resolutions, and then halves the ratio of these.
    """
    low = high = None
    resolution, best = 1.0, None
    for _ in range(STEPS):
        found = count(resolution)
        if best is None or abs(found - wanted) < abs(best[0] - wanted):
            best = (found, resolution)
        if found == wanted:
            break
        if found < wanted:
            low = resolution
        else:
            high = resolution
        if low is None:
            resolution = high / STRIDE
        elif high is None:
            resolution = low * STRIDE
        else:
            resolution = (low * high) ** 0.5
    return best[1]
