from __future__ import annotations

import gc
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
