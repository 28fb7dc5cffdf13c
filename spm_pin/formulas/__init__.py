"""The formulas of the mechanism, each once: straight lines of arithmetic on numbers and tuples of numbers.

One file per subject of `docs/theory`, with the symbols used there. A formula has no loop over a batch, no `if` on a
value, no default argument and no closure; it calls `sqrt`, `where`, `both` and `either` of `operations` in place of
whatever a kind of number has for them. So one formula runs on many kinds of numbers:

- compiled loops over batches: `spm_pin.kinematics.kernels`, which Numba compiles from the functions as they stand;
- expressions of CasADi, ball arithmetic, numbers of many digits, arrays: by `operations.bind`, which copies a formula
  and all that it calls with other operations in place of those of floats.

Dimensions are arguments, never read from a `Manipulator`.
"""
