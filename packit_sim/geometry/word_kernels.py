"""Kernels for words of 4 x 4 x 4 bits (see `bits`).

Two are instructions of the processor (trailing zeros, population count), which numba does not offer
for words: intrinsics that emit LLVM's. Rotations of a word are sequences of delta swaps (Warren,
"Hacker's Delight", exchanging bit fields): each exchanges the bits of a mask with those a shift
away, so that any permutation of axes and signs takes a few operations for 64 cells.
"""

from __future__ import annotations

from typing import Any

import numba
from llvmlite import ir
from numba.extending import intrinsic

from packit_sim.core.compilation import kernel


@intrinsic
def lowest_bit(context: Any, word: Any) -> Any:
    """Return the number of the lowest bit that is set in a word other than 0."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        # The second argument: the result for 0 need not be defined.
        return builder.cttz(arguments[0], ir.Constant(ir.IntType(1), 1))

    return numba.int64(numba.uint64), generate


@intrinsic
def count_bits(context: Any, word: Any) -> Any:
    """Return how many bits of a word are set."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.ctpop(arguments[0])

    return numba.int64(numba.uint64), generate


@kernel
def turn_words(words, swaps):
    """Rotate the bits of words (n,) in place by swaps (m, 2) (see `bits.turning_swaps`)."""
    # Swaps outside, words inside: shift and mask are constants of the inner loop.
    for s in range(len(swaps)):
        shift, mask = swaps[s]
        for n in range(len(words)):
            word = words[n]
            moved = (word >> shift ^ word) & mask
            words[n] = word ^ moved ^ moved << shift
