"""What came of fuzzing, tried again, and a little of it anew."""

from __future__ import annotations

import pytest
from fuzz.first_seeds import seeds_of
from fuzz.targets import TARGETS, attempt
from hypothesis import given, settings
from hypothesis import strategies as st


@pytest.mark.parametrize("name", TARGETS)
def test_some_seed_is_taken_and_none_breaks_anything(name: str) -> None:
    taken = [attempt(name, seed) for seed in seeds_of(name)]
    assert any(taken)


@pytest.mark.parametrize("name", TARGETS)
@settings(max_examples=60)
@given(data=st.data())
def test_damage_is_an_error_of_ours(name: str, data: st.DataObject) -> None:
    """Octets left out, put in and changed, in what is well-formed."""
    octets = bytearray(data.draw(st.sampled_from(list(seeds_of(name)))))
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(octets)))
        until = data.draw(st.integers(at, min(len(octets), at + 8)))
        octets[at:until] = data.draw(st.binary(max_size=8))
    attempt(name, bytes(octets))
