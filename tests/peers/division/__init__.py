"""What anybody can take from a Python library to divide a fleet, on the observations that Muster has.

options   what tests/peers/divide is asked for
graphs    a line of observations as graphs
spectral  spectral clustering, and k-means on positions, by scikit-learn
leiden    multiplex Leiden by leidenalg
search    for the resolution that gives a number of teams
tree      the tree of command, cut near its top
"""
