"""Compiled kernels: the formulas of the closed form, written once, over scalars.

A formula is a small function of plain numbers marked `jit_inline`. A kernel is a loop over a batch that calls them, and
the only thing that is compiled on its own. Where the formula is straight-line arithmetic the loop goes over tiles of
`TILE` problems: their numbers are put into rows of a small array, so that the compiler takes several problems into
one vector register, and a single problem is computed exactly like a million. Tiles on the stack (`tile_memory`) save
the second version of every loop that the compiler makes for arrays that may overlap.

Nothing here checks an argument; the public functions do. Importing this package imports Numba, so they do it when
called.

No fast-math flag is set, not even the contraction of a product and a sum into one instruction: NaN marks a solution
that is not real, infinity a division whose result is discarded, and without contraction straight-line arithmetic gives
the same bits on every processor, in every place of a batch, and in the interpreter.
"""
