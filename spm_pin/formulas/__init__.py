"""The formulas of the mechanism, each once: straight lines of arithmetic on numbers and tuples of numbers.

One file per subject of `docs/theory`, with the symbols used there. A formula has no loop over a batch, no `if` on a
value, no default argument and no closure; it calls `sqrt`, `where`, `both` and `either` of `operations`, so that
each backend can replace them. One formula is evaluated on many scalar types:

- in compiled loops over batches: `spm_pin.kinematics.kernels`, which Numba compiles from the unchanged functions;
- on CasADi expressions, ball arithmetic, numbers of many digits, arrays: by `operations.bind`, which copies a formula
    and all formulas that it calls, with other operations.

Dimensions are arguments, never read from a `Manipulator`.
"""
