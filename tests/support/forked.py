"""Tests in several processes, forked once all is collected: `pytest --processes 4`.

What is collected and imported once is there for all of them. Whoever has done a file is given the
next one, in the order of the collection; a process that dies fails the test that it was at, and
another one goes on.
"""

from __future__ import annotations

import gc
import multiprocessing
import os
from collections import deque
from collections.abc import Iterator
from itertools import count, groupby
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess

import pytest

NUMBER = "PLOTFEED_TEST_PROCESS"  # What tells a process of tests, and whatever it starts, its own


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--processes", type=int, default=0, help="how many the tests are run in")


def pytest_runtestloop(session: pytest.Session) -> bool | None:
    processes = session.config.getoption("processes")
    if not processes or session.config.option.collectonly:
        return None  # pytest's own loop
    if session.testsfailed and not session.config.option.continue_on_collection_errors:
        raise session.Interrupted(f"{session.testsfailed} errors during collection")
    files = [list(tests) for _, tests in groupby(session.items, key=lambda item: item.path)]
    session.config._tmp_path_factory.getbasetemp()  # type: ignore[attr-defined]
    gc.collect()
    gc.freeze()  # no process copies it all to look for garbage in it
    _Parent(session, files).run(min(processes, len(files)))
    return True


class _Parent:
    """Hands out files, and tells pytest what became of their tests."""

    def __init__(self, session: pytest.Session, files: list[list[pytest.Item]]) -> None:
        self._session = session
        self._files = files
        self._next = deque((file, 0) for file in range(len(files)))  # And from which test on
        self._numbers = count()
        self._at: dict[Connection, tuple[BaseProcess, tuple[int, int] | None]] = {}

    def run(self, processes: int) -> None:
        for _ in range(processes):
            self._start()
        try:
            while self._at:
                for connection in wait(list(self._at)):
                    assert isinstance(connection, Connection)
                    self._hear(connection)
        finally:
            for process, _ in self._at.values():
                process.kill()
        if self._session.shouldfail:
            raise self._session.Failed(self._session.shouldfail)

    def _start(self) -> None:
        ours, theirs = multiprocessing.Pipe()
        context = multiprocessing.get_context("fork")
        given = next(self._numbers), self._session, self._files, theirs
        process = context.Process(target=_work, args=given)
        process.start()
        theirs.close()
        self._at[ours] = process, None

    def _hear(self, connection: Connection) -> None:
        process, at = self._at[connection]
        item = None if at is None else self._files[at[0]][at[1]]
        hook = self._session.config.hook
        try:
            what, said = connection.recv()
        except EOFError:
            del self._at[connection]
            process.join()
            if at is not None and item is not None:
                self._next.appendleft((at[0], at[1] + 1))
                says = f"the process that ran it ended, {process.exitcode}"
                hook.pytest_runtest_logreport(
                    report=pytest.TestReport(item.nodeid, item.location, {}, "failed", says, "call")
                )
                self._start()
            return
        if what == "asks":
            more = bool(self._next) and not self._session.shouldfail
            connection.send(self._next.popleft() if more else None)
        elif what == "begins":
            self._at[connection] = process, said
        elif what == "reports":
            report = hook.pytest_report_from_serializable(config=self._session.config, data=said)
            hook.pytest_runtest_logreport(report=report)
        elif item is not None:
            self._at[connection] = process, None
            hook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)


def _work(
    number: int, session: pytest.Session, files: list[list[pytest.Item]], parent: Connection
) -> None:
    """In a process: what is asked of it, until nothing is."""
    os.environ[NUMBER] = str(number)
    config = session.config
    config.pluginmanager.unregister(name="terminalreporter")
    capture = config.pluginmanager.getplugin("capturemanager")
    capture.stop_global_capturing()
    capture.start_global_capturing()  # in files of its own

    class Reports:
        def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
            data = config.hook.pytest_report_to_serializable(config=config, report=report)
            parent.send(("reports", data))

    config.pluginmanager.register(Reports())

    def tests() -> Iterator[tuple[int, int]]:
        while True:
            parent.send(("asks", None))
            if (given := parent.recv()) is None:
                return
            file, first = given
            yield from ((file, test) for test in range(first, len(files[file])))

    coming = tests()
    at = next(coming, None)
    while at is not None:
        parent.send(("begins", at))
        file, test = at
        at = next(coming, None)
        following = None if at is None else files[at[0]][at[1]]
        config.hook.pytest_runtest_protocol(item=files[file][test], nextitem=following)
        parent.send(("done", None))
