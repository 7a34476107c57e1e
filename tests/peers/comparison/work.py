"""How much a search for singular triplets computes and moves, to be held against the machine's limits.

An estimate, rather from above: it takes every direction as open until the last round, while those that
are found are searched for no more. Names are those of shared/numeric/src/svd/davidson.rs.
"""

# Vectors that are computed in addition to those asked for, to a multiple of a register.
EXTRA = 8
REGISTER = 8
# Products of the preconditioner in a round: its degree, which is 2 to 4, with the matrix and with its
# transpose.
SINGLE_PRODUCTS = 2 * 3
# New directions that the space has room for, in rounds, and what they are a multiple of.
ROUNDS = 2
SMALL_ROUNDS = 1
SMALL = 2048
SINGLE_REGISTER = 16


def search(robots, edges, rank, rounds):
    """Operations and bytes of `rounds` rounds."""
    block = -(-(rank + EXTRA) // REGISTER) * REGISTER
    directions = -(-rank // SINGLE_REGISTER) * SINGLE_REGISTER
    # On average: it grows from the carried vectors until it is full.
    space = block + (SMALL_ROUNDS if robots <= SMALL else ROUNDS) * directions / 2
    # Two products in double precision, of rows of `block` numbers: read and written once each.
    products = 2 * (12 * edges + 16 * robots * block)
    products += SINGLE_PRODUCTS * (8 * edges + 12 * robots * block)
    # Directions against the space, whose vectors and images are read, and the best of it written.
    dense = 8 * robots * (4 * space + 10 * block)
    operations = (2 + SINGLE_PRODUCTS) * 2 * edges * block
    operations += 2 * robots * block * (6 * space + 3 * block)
    return {"operations": rounds * operations, "bytes": rounds * (products + dense)}
