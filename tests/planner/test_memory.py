"""What is remembered is a dict that is emptied when it is two thirds full."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from regrasp.planner.memory import forget, new_memory, remember, slot_of

WIDTH, BITS = 3, 4
NUMBERS = st.one_of(st.integers(-2, 2), st.sampled_from([-(2**63), 2**63 - 1, 1 << 32, 1 << 32 | 1]))
KEYS = st.tuples(*[NUMBERS] * WIDTH)


@settings(max_examples=200, deadline=None)
@given(st.lists(st.one_of(st.none(), st.tuples(KEYS, st.floats(allow_nan=False))), max_size=60))
def test_a_memory_is_a_dict(steps: list[tuple[tuple[int, ...], float] | None]) -> None:
    """Keys that are asked for are found with what was put there, and no others; None empties it on the way."""
    memory, told = new_memory(BITS, WIDTH), {}
    asked = {step[0] for step in steps if step is not None}
    for step in steps:
        if step is None:
            forget(memory)
            told = {}
        else:
            key, value = step
            slot = slot_of(memory, np.array(key, np.int64))
            assert memory.taken[slot] == (key in told)
            if key not in told:
                remember(memory, slot, np.array(key, np.int64), value)
                told[key] = value
                if 3 * len(told) > 2 * 2**BITS:
                    told = {}
        assert memory.count[0] == memory.taken.sum() == len(told)
        for key in asked:
            slot = slot_of(memory, np.array(key, np.int64))
            assert memory.taken[slot] == (key in told)
            if key in told:
                assert memory.values[slot] == told[key]


@pytest.mark.parametrize("width", [1, 2, 7])
def test_keys_that_differ_in_one_number_are_told_apart(width: int) -> None:
    """By one bit of one number, in any place; memories of thousands of keys answer as little ones."""
    rng = np.random.default_rng(0)
    memory = new_memory(12, width)
    base = rng.integers(-(2**62), 2**62, width)
    keys = [base]
    for place in range(width):
        for bit in range(64):
            key = base.copy()
            key[place] ^= np.int64(-(2**63)) if bit == 63 else np.int64(1) << bit
            keys.append(key)
    keys += list(rng.integers(-5, 5, (1500, width)) * np.int64(10**9))
    keys = list(np.unique(keys, axis=0))
    for value, key in enumerate(keys):
        slot = slot_of(memory, key)
        assert not memory.taken[slot]
        remember(memory, slot, key, float(value))
    assert [memory.values[slot_of(memory, key)] for key in keys] == list(range(len(keys)))
    assert not memory.taken[slot_of(memory, base + 1)] or np.any([np.array_equal(base + 1, key) for key in keys])
