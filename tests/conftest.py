from __future__ import annotations

import gc
import sys
from collections.abc import Generator, Iterator
from contextlib import suppress
from importlib import import_module
from itertools import chain, groupby, zip_longest

import pytest
from hypothesis import settings
from support.allowed_skips import allowed_skips, no_skip
from support.forked import pytest_addoption, pytest_runtestloop
from support.given_files import more_input

from plotfeed.feeds.console import process

__all__ = ["pytest_addoption", "pytest_runtestloop"]

# Packages that tests use and that take seconds to load.
LARGE = ("asterix.generated", "matplotlib.figure", "scipy.stats", "playwright.sync_api")
# Files that take longest are begun first: the last to end is then a short one.
LONGEST = (
    *("test_parts_over_mqtt", "test_fleet_command", "test_verdicts", "test_needs"),
    *("test_display_in_browser", "test_tracker_sweep", "test_feed_checks", "test_help"),
    *("test_page_in_browser", "test_asyncapi", "test_attack_recordings", "test_planted_faults"),
    *("test_page_of_runs", "test_session_switch", "test_sweep", "test_oracle"),
    *("test_shipped_scenes", "test_inject"),
)
ALLOWED = allowed_skips()
collect_ignore_glob = [] if more_input() else ["*/test_more_*.py"]

# A machine that is busy with something else makes no test wrong. Each run draws examples anew, half
# as many as is usual; what takes octets from outside is fuzzed besides (tools/fuzz).
settings.register_profile("plotfeed", settings(), deadline=None, max_examples=50)
settings.load_profile("plotfeed")


@pytest.fixture(scope="session", autouse=True)
def _nothing_to_leave_alone() -> Iterator[None]:
    """Else each session looks for garbage in all that pytest holds, a third of a second long."""
    name = "leave_alone_what_is_there"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(process, name, lambda: None)
        if run := sys.modules.get("plotfeed.feeds.cli.run"):  # else it takes that one
            patch.setattr(run, name, lambda: None)
        yield


@pytest.fixture(scope="module", autouse=True)
def _nothing_left_open() -> Iterator[None]:
    """What a file's tests have not closed is told of at its end, and not in another file's test."""
    yield
    gc.collect()


def pytest_collection_finish(session: pytest.Session) -> None:
    """Load once what all that are forked hereafter need, and have one process be `plotfeed`."""
    if session.config.getoption("processes") and (command := sys.modules.get("support.command")):
        command.ready()
        for name in LARGE:
            with suppress(ImportError):
                import_module(name)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The longest files, then those of feeds, which mostly wait, and others by turns."""
    items.sort(key=lambda item: item.path)  # in whatever order they were collected
    files = [list(tests) for _, tests in groupby(items, key=lambda item: item.path)]
    longest = [tests for tests in files if tests[0].path.stem in LONGEST]
    longest.sort(key=lambda tests: LONGEST.index(tests[0].path.stem))
    files = [tests for tests in files if tests not in longest]
    waiting = [tests for tests in files if "feeds" in tests[0].path.parts]
    computing = [tests for tests in files if "feeds" not in tests[0].path.parts]
    pairs = zip_longest(waiting, computing, fillvalue=[])
    items[:] = chain.from_iterable([*longest, *chain.from_iterable(pairs)])


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    report = yield
    no_skip(report, ALLOWED)
    return report


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report(
    collector: pytest.Collector,
) -> Generator[None, pytest.CollectReport, pytest.CollectReport]:
    report = yield
    no_skip(report, ALLOWED)
    return report
