"""What came of fuzzing, tried again, and a little of it anew, within a budget for each input."""

from __future__ import annotations

import ast
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from random import Random

import pytest
from fuzz.first_seeds import seeds_of
from fuzz.mutate import mutated
from fuzz.run_fuzz import MOST_MIB, SLOWEST_S
from fuzz.targets import DOORS, TARGETS, attempt

FEEDS = Path(__file__).parents[1] / "feeds"
# Calls by which octets of strangers come in.
OPENERS = {"start_server", "open_connection", "create_connection", "receiver_at", "serve", "Config"}
OPENERS |= {"create_server", "read_apart", "file_octets"}
INPUTS = 50  # Of each target


@contextmanager
def budget() -> Iterator[None]:
    """Fail where one input takes more of a processor or of memory than it may."""
    resource = pytest.importorskip("resource")
    kib = 1024 if sys.platform == "darwin" else 1

    def out_of_time(*_: object) -> None:
        raise AssertionError(f"more than {SLOWEST_S} s of a processor")

    before = signal.signal(signal.SIGPROF, out_of_time)
    had = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    signal.setitimer(signal.ITIMER_PROF, SLOWEST_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)
    grew_mib = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - had) / 1024 / kib
    assert grew_mib < MOST_MIB


@pytest.mark.parametrize("name", TARGETS)
def test_what_is_made_of_seeds_is_taken_or_refused_within_its_budget(name: str) -> None:
    """Some seed is taken, and what is changed of one by its structure is an error of ours."""
    seeds = list(seeds_of(name))
    taken = [attempt(name, seed) for seed in seeds]
    assert any(taken)
    for seed in seeds:
        with budget():
            attempt(name, seed)
    for n in range(INPUTS):
        rng = Random(f"{name} {n}")  # noqa: S311
        data = mutated(rng.choice(seeds), rng)[:65_536]
        try:
            with budget():
                attempt(name, data)
        except BaseException:
            print(f"input {n} of {name}: {data[:2000]!r}")
            raise


def test_every_door_has_a_target() -> None:
    """Who opens a socket or reads a file of strangers says by which target that is tried."""
    found = set()
    for path in FEEDS.rglob("*.py"):
        module, text = str(path.relative_to(FEEDS)), path.read_text()
        if not any(f"{opener}(" in text for opener in OPENERS):
            continue
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.Call):
                called = getattr(node.func, "attr", getattr(node.func, "id", ""))
                if called in OPENERS:
                    found.add(module)
    assert found == DOORS.keys()
    assert {target for targets in DOORS.values() for target in targets} <= TARGETS.keys()
    assert set(TARGETS) - {t for targets in DOORS.values() for t in targets} == {
        *("asterix", "plots", "scene")
    }
