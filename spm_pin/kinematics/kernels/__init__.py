"""Compiled kernels: loops over batches that run `spm_pin.formulas`, and iterations.

A kernel is a loop over a batch, and is the unit of compilation, when that is worthwhile: see
`compilation.is_worth_compiling`. Where a formula is straight-line
arithmetic the loop goes over tiles of `TILE` problems: their numbers are put into the rows of one small array, and the
results into other rows of it, so that the compiler takes several problems into one vector register, and a single
problem is computed exactly like a million. With several arrays in a loop the compiler cannot prove that they do not
overlap, and computes one problem after another.

Nothing here checks an argument; the public functions do. The modules are imported when a function is first called,
Numba when a kernel is first compiled.

No fast-math flag is set, not even the contraction of a product and a sum into one instruction: NaN marks a solution
that is not real, infinity a division whose result is discarded, and without contraction straight-line arithmetic gives
the same bits on every processor, in every place of a batch, and in the interpreter.
"""

RESOLUTION = 1e-9
"""Resolution of distances in a search for states, relative to the machine's size."""
