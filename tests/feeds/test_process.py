from __future__ import annotations

import gc
import subprocess
import sys

import pytest

from plotfeed.feeds.console import process
from plotfeed.feeds.console.process import (
    GARBAGE_OF_SESSION,
    SWITCH_S,
    leave_alone_what_is_there,
    undisturbed,
)


def test_what_keeps_a_loop_undisturbed_is_put_back_whatever_happens(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(process, "leave_alone_what_is_there", leave_alone_what_is_there)
    before = sys.getswitchinterval(), gc.get_threshold()
    seen = []

    def fail() -> None:
        with undisturbed(GARBAGE_OF_SESSION):
            seen.append((sys.getswitchinterval(), gc.get_threshold()[0], gc.get_freeze_count()))
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail()
    ((switch_s, garbage, frozen),) = seen
    assert switch_s == pytest.approx(SWITCH_S)
    assert garbage == GARBAGE_OF_SESSION
    assert frozen > 0
    assert (sys.getswitchinterval(), gc.get_threshold()) == before
    assert gc.get_freeze_count() == 0


@pytest.mark.parametrize(
    ("modules", "absent"),
    [
        ("plotfeed", {"numpy"}),
        ("plotfeed.feeds.cli.main", {"numpy", "pydantic", "google", "asyncio", "mcap"}),
        (
            "plotfeed.feeds.cli.run, plotfeed.feeds.page.run_with_page",
            {"starlette", "uvicorn", "websockets"},
        ),
    ],
)
def test_nobody_waits_for_a_library_that_is_not_needed_yet(modules: str, absent: set[str]) -> None:
    code = f"import sys, {modules}; print({absent} & sys.modules.keys())"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "set()\n"
