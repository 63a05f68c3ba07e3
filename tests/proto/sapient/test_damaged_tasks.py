from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st
from support.sapient_tasks import ONE, task

from plotfeed.proto.errors import DecodeError
from plotfeed.proto.sapient.decode_sapient import decode_task


@given(
    st.integers(0, 90),
    st.binary(min_size=1, max_size=3),
    st.integers(-(2**63), 2**63 - 1),
    st.integers(-(2**31), 2**31 - 1),
)
def test_damaged_tasks_are_decoded_or_refused(
    at: int, damage: bytes, seconds: int, nanos: int
) -> None:
    begins = {
        "seconds": (seconds + 2**63) % 2**64 - 2**63,
        "nanos": (nanos + 2**31) % 2**32 - 2**31,
    }
    whole = task(ONE, request="Status", more={"task_start_time": begins})
    for data in (whole, whole[:at] + damage + whole[at + len(damage) :]):
        try:
            asked = decode_task(data)
        except DecodeError as error:
            assert "\n" not in str(error)
        else:
            assert len(asked.task_id) == 26
