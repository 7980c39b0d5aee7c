"""Values remembered under keys of whole numbers: what has been computed once on an arc is not computed again."""

import numpy as np
from numpy.typing import NDArray

from regrasp.kernels.native import kernel
from regrasp.kernels.records import Record

Ints = NDArray[np.int64]

_FIRST, _PRIME = np.int64(1469598103934665603), np.int64(1099511628211)  # of the FNV-1a hash, less its top bit


class Memory(Record):
    """A table with open addresses for M = 2^b keys of W numbers. A key stands whole, so an answer is never another's.

    keys (M, W); values (M,); taken (M,); count (1,).
    """

    keys: Ints
    values: NDArray[np.float64]
    taken: NDArray[np.uint8]
    count: Ints


def new_memory(bits: int, width: int) -> Memory:
    """An empty memory for 2^bits keys of `width` numbers."""
    size = 1 << bits
    return Memory(np.zeros((size, width), np.int64), np.zeros(size), np.zeros(size, np.uint8), np.zeros(1, np.int64))


@kernel
def slot_of(memory: Memory, key: Ints) -> int:
    """The slot in which the key stands, or the free one where it would."""
    keys, taken = memory.keys, memory.taken
    h = _FIRST
    for w in range(key.shape[0]):
        h = (h ^ key[w]) * _PRIME
        h ^= h >> 29
    last = taken.shape[0] - 1
    slot = h & last
    while taken[slot]:
        same = True
        for w in range(key.shape[0]):
            if keys[slot, w] != key[w]:
                same = False
                break
        if same:
            break
        slot = (slot + 1) & last
    return slot


@kernel
def remember(memory: Memory, slot: int, key: Ints, value: float) -> None:
    """Put a value into the free slot that `slot_of` gave for the key. A memory two thirds full is emptied after."""
    for w in range(key.shape[0]):
        memory.keys[slot, w] = key[w]
    memory.values[slot] = value
    memory.taken[slot] = 1
    memory.count[0] += 1
    if 3 * memory.count[0] > 2 * memory.taken.shape[0]:
        forget(memory)


@kernel
def forget(memory: Memory) -> None:
    """Empty the memory."""
    memory.taken[:] = 0
    memory.count[0] = 0
