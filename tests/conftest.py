from __future__ import annotations

import sys
from collections.abc import Generator, Iterator
from itertools import chain, groupby, zip_longest
from pathlib import Path

import pytest
from hypothesis import settings
from support.allowed_skips import allowed_skips, no_skip
from support.given_files import more_input

from plotfeed.feeds.console import process

TESTS = Path(__file__).parent
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


def pytest_configure(config: pytest.Config) -> None:
    """Of several processes each collects other rooms first.

    A file whose assertions one of them has rewritten is there for the others, which else would all
    do it at once: half the work of a process that collects.
    """
    process = getattr(config, "workerinput", None)
    if process is None or config.args_source is not config.ArgsSource.TESTPATHS:
        return
    rooms = [room_of(file) for file in sorted(TESTS.rglob("test_*.py"))]
    first = len(rooms) * int(process["workerid"].removeprefix("gw")) // process["workercount"]
    config.args = list(map(str, dict.fromkeys(rooms[first:] + rooms[:first])))


def room_of(file: Path) -> Path:
    """The folder of a test, or the file where it lies by itself."""
    parts = file.relative_to(TESTS).parts
    return TESTS.joinpath(*parts[: 2 if parts[0] == "feeds" else 1])


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Files of feeds, which mostly wait, and others, which compute, by turns for the processes."""
    items.sort(key=lambda item: item.path)  # in whatever order they were collected
    files = [list(tests) for _, tests in groupby(items, key=lambda item: item.path)]
    waiting = [tests for tests in files if "feeds" in tests[0].path.parts]
    computing = [tests for tests in files if "feeds" not in tests[0].path.parts]
    pairs = zip_longest(waiting, computing, fillvalue=[])
    items[:] = chain.from_iterable(chain.from_iterable(pairs))


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
