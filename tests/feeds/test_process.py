from __future__ import annotations

import gc
import sys

import pytest

from plotfeed.feeds.console.process import GARBAGE_OF_SESSION, SWITCH_S, undisturbed


def test_what_keeps_a_loop_undisturbed_is_put_back_whatever_happens() -> None:
    before = sys.getswitchinterval(), gc.get_threshold()
    with pytest.raises(ZeroDivisionError), undisturbed(GARBAGE_OF_SESSION):
        assert sys.getswitchinterval() == pytest.approx(SWITCH_S)
        assert gc.get_threshold()[0] == GARBAGE_OF_SESSION
        assert gc.get_freeze_count() > 0
        raise ZeroDivisionError
    assert (sys.getswitchinterval(), gc.get_threshold()) == before
    assert gc.get_freeze_count() == 0
