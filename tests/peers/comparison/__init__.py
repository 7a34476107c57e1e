"""The comparison of Muster's mathematics with its peers, which tests/peers/compare starts.

`__main__` runs the parts: `decomposition`, `pipeline`, `embeddings`, `clustering` and `growth`, each in
a module that says what is compared. `katz` is scipy's side and measures residuals, `worker` speaks to
the program in ../rust, `goals` compares with the goals, `work` estimates what a search computes, `report` and `plot`
write down. `options` and `old_worker` stand alone: the one runs before anything is installed, the other
with other libraries.
"""
