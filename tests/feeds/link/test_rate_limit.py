from __future__ import annotations

from support.links import NS, START_NS, due_times, link, passed

from plotfeed.feeds.link.impairment import Impairment
from plotfeed.proto import plotfeed_pb2 as pb

MS = 1_000_000


def test_a_message_takes_the_time_of_its_octets_and_of_its_headers() -> None:
    impairment = Impairment(link(rate_kbit_s=80.0, overhead_octets=40), 1, "radar")
    (copy,) = impairment.pass_on(START_NS, 60).copies
    assert copy.due_utc_ns == START_NS + 10 * MS  # 100 octets at 10 octets a millisecond
    (behind,) = impairment.pass_on(START_NS + MS, 160).copies
    assert behind.due_utc_ns == START_NS + 30 * MS
    (later,) = impairment.pass_on(START_NS + 50 * MS, 0).copies
    assert later.due_utc_ns == START_NS + 54 * MS


def test_the_delay_comes_after_the_queue() -> None:
    impairment = Impairment(link(rate_kbit_s=80.0, latency_ms=7.0), 1, "radar")
    dues = [impairment.pass_on(START_NS, 100).copies[0].due_utc_ns for _ in range(3)]
    assert dues == [START_NS + (10 * n + 7) * MS for n in (1, 2, 3)]


def test_a_full_queue_drops_exactly_what_does_not_fit() -> None:
    impairment = Impairment(link(rate_kbit_s=80.0, queue_messages=5), 1, "radar")
    fates = [impairment.pass_on(START_NS, 100).fate for _ in range(9)]
    assert fates == [pb.SENT] * 5 + [pb.QUEUE_FULL] * 4
    # After 25 ms two are through, and the third is being sent.
    fates = [impairment.pass_on(START_NS + 25 * MS, 100).fate for _ in range(9)]
    assert fates == [pb.SENT] * 2 + [pb.QUEUE_FULL] * 7


def test_a_saturated_link_sends_at_its_rate() -> None:
    asked = link(rate_kbit_s=48.0, queue_messages=10)  # 100 messages of 60 octets a second
    outcomes = passed(asked, due_times(5000, 1000))
    left = [copy.due_utc_ns for o in outcomes for copy in o.copies]
    assert left == [START_NS + (n + 1) * 10 * MS for n in range(len(left))]
    assert len(left) == 500 + 10 - 1  # 4.999 s, and the queue that is still full


def test_a_copy_takes_its_place_in_the_queue() -> None:
    impairment = Impairment(link(rate_kbit_s=80.0, duplicate=1.0, queue_messages=3), 1, "radar")
    first, second = impairment.pass_on(START_NS, 100).copies
    assert (first.due_utc_ns, second.due_utc_ns) == (START_NS + 10 * MS, START_NS + 20 * MS)
    third = impairment.pass_on(START_NS, 100)
    assert [c.due_utc_ns for c in third.copies] == [START_NS + 30 * MS]
    assert impairment.pass_on(START_NS, 100).fate == pb.QUEUE_FULL


def test_a_queue_outlives_a_change_of_rate() -> None:
    impairment = Impairment(link(rate_kbit_s=80.0), 1, "radar")
    impairment.pass_on(START_NS, 1000)  # until 100 ms
    impairment.change(link(rate_kbit_s=800.0))
    (copy,) = impairment.pass_on(START_NS, 1000).copies
    assert copy.due_utc_ns == START_NS + 110 * MS
    impairment.change(link())
    (copy,) = impairment.pass_on(START_NS + MS, 1000).copies
    assert copy.due_utc_ns == START_NS + 110 * MS  # behind what was taken
    (copy,) = impairment.pass_on(START_NS + NS, 1000).copies
    assert copy.due_utc_ns == START_NS + NS


def test_what_is_lost_takes_no_place_in_the_queue() -> None:
    asked = link(rate_kbit_s=80.0, loss={"kind": "random", "probability": 1.0})
    impairment = Impairment(asked, 1, "radar")
    assert {impairment.pass_on(START_NS, 100).fate for _ in range(9)} == {pb.LOST}
    impairment.change(link(rate_kbit_s=80.0))
    assert impairment.pass_on(START_NS, 100).copies[0].due_utc_ns == START_NS + 10 * MS
