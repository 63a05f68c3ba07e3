"""What a replay sends: which messages, under which topics, with which times, over which links."""

from __future__ import annotations

import asyncio
import socket
from collections import Counter
from collections.abc import Callable, Sequence
from fractions import Fraction
from pathlib import Path

import pytest
from google.protobuf import json_format
from support.brokers import has_ipv6
from support.command import plotfeed
from support.recordings import plots as datagrams
from support.replays import MS, RECORDED, REPLAYED, Memory, S, message, simulated
from support.scene_files import radar, scene_file, scene_text
from support.udp_receiver import LOOPBACK_INTERFACE, heard, place, receiver
from support.waiting import PATIENCE_S

from plotfeed.feeds.messages.message import Message, attributes
from plotfeed.feeds.messages.transports import Transport
from plotfeed.feeds.replaying.replay_settings import (
    LinkRule,
    Moment,
    ReplayError,
    ReplaySettings,
    Stamps,
    TopicRule,
)
from plotfeed.feeds.replaying.replayer import READY_NS, Replayer, Restamper
from plotfeed.feeds.replaying.routes import RecordedUdp, ReplayCounters, ReplayUdp, source_of
from plotfeed.feeds.scene.link_keys import LinkSettings
from plotfeed.feeds.scene.output_keys import UdpDestination
from plotfeed.feeds.scene.scene import load
from plotfeed.feeds.telemetry.position_report import decode as decode_report
from plotfeed.feeds.transport.ways_out import TransportError
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.sapient.envelope import envelope
from plotfeed.proto.utc import iso_utc
from plotfeed.replay.mcap import McapReader
from plotfeed.replay.recorded import Recorded, Stage

LEDGER = "application/x-protobuf; messageType=plotfeed.v1.Ledger"
OF_A_SESSION = [
    message(0, "p/radar/plots", stage=Stage.BEFORE),
    message(1, "p/radar/plots"),
    message(2, "p/radar/status", retain=True),
    message(3, "p/truth", content_type=LEDGER),
    message(4, "p/telemetry/d1", stage=Stage.TELEMETRY),
    message(5, "p/control", stage=Stage.TELEMETRY),
    message(6, "p/radar/sapient/task", stage=Stage.TELEMETRY),
]
HEARD = [
    message(0, "x/y/telemetry/d2", stage=Stage.RECEIVED),
    message(1, "x/y/truth", stage=Stage.RECEIVED),
    message(2, "x/y/radar/sapient", stage=Stage.RECEIVED),
    message(3, "x/y/control", stage=Stage.RECEIVED),
    message(4, "udp/10.0.0.1/8600", stage=Stage.RECEIVED),
    message(5, "x/odd", content_type=LEDGER, stage=Stage.RECEIVED),
    message(6, "x/y/radar/sapient/task", stage=Stage.RECEIVED),
]


@pytest.mark.parametrize(
    ("settings", "of_a_session", "heard"),
    [
        (ReplaySettings(), [1, 2], [2, 4]),
        (ReplaySettings(truth=True), [1, 2, 3], [1, 2, 4, 5]),
        (ReplaySettings(stage="before"), [0], []),
        (ReplaySettings(stage="telemetry"), [4], [0]),
    ],
)
@pytest.mark.asyncio
async def test_what_is_replayed_is_what_was_asked_for(
    settings: ReplaySettings, of_a_session: list[int], heard: list[int]
) -> None:
    for recorded, wanted in ((OF_A_SESSION, of_a_session), (HEARD, heard)):
        ears, _ = await simulated(recorded, settings)
        topics = [m.topic for _, m in ears.heard]
        assert topics == [recorded[i].topic for i in wanted]


async def topics_by(recorded: list[Recorded], *rules: str) -> tuple[list[str], Counter[str]]:
    settings = ReplaySettings(topics=tuple(TopicRule.parse(rule) for rule in rules))
    ears, totals = await simulated(recorded, settings)
    return [m.topic for _, m in ears.heard], totals.skipped


@pytest.mark.asyncio
async def test_topics_are_renamed_by_the_first_rule_and_by_whole_levels() -> None:
    """What no broker takes is skipped and counted."""
    recorded = [message(i, t) for i, t in enumerate(["a/b/c", "a/b", "a/bc", "a", "z/a/b"])]
    renamed, _ = await topics_by(recorded, "a/b=n", "a=m/k")
    assert renamed == ["n/c", "n", "m/k/bc", "m/k", "z/a/b"]
    assert (await topics_by(recorded, "a=b", "b=c"))[0] == ["b/b/c", "b/b", "b/bc", "b", "z/a/b"]
    recorded = [message(0, "a/+"), message(1, "a#"), message(2, ""), message(3, "a")]
    topics, skipped = await topics_by(recorded)
    assert (topics, skipped.total()) == (["a"], 3)
    assert (await topics_by(recorded[:1], "a=n"))[0] == []


def moment_ns(text: str) -> int:
    return Moment.parse(text).at(RECORDED)


def plots(t_ns: int) -> bytes:
    sent = [pb.Plot(time_utc_ns=t_ns, range_m=5.0)]
    return pb.PlotBatch(sensor="radar", plots=sent).SerializeToString()


def tracks(t_ns: int) -> bytes:
    sent = [pb.Track(time_utc_ns=t_ns, latitude_deg=5.0)]
    return pb.TrackBatch(sensor="radar", tracks=sent).SerializeToString()


def plot_048(t_ns: int) -> bytes:
    time_lsb = round(t_ns % (86_400 * S) * 128 / S) % (86_400 * 128)
    return bytes.fromhex("30 000a e0 1903") + time_lsb.to_bytes(3, "big") + b"\x30"


NODE = "4f3c1b6e-7a0d-4d6a-9a57-0b9a8f5f2c11"


def sapient(t_ns: int) -> bytes:
    message = envelope(NODE, t_ns)
    message.status_report.report_id = "01KDWN1Q6P2Y5T8C3V9X4Z7B0M"
    return message.SerializeToString()


def status(t_ns: int) -> bytes:
    return f'{{"sensor": "radar", "time_utc": "{iso_utc(t_ns)}"}}'.encode()


OURS = "application/x-protobuf; messageType="
KINDS = {
    "p/radar/plots": (plots, f"{OURS}plotfeed.v1.PlotBatch"),
    "p/radar/tracks": (tracks, f"{OURS}plotfeed.v1.TrackBatch"),
    "p/radar/asterix/048": (plot_048, "application/x-asterix; cat=48"),
    "p/radar/sapient": (sapient, f"{OURS}sapient_msg.bsi_flex_335_v2_0.SapientMessage"),
    "p/radar/status": (status, "application/json"),
}


@pytest.mark.parametrize("topic", [*KINDS, "udp/239.1.2.3/8600"])
@pytest.mark.parametrize("told", [True, False], ids=["content type", "3.1.1"])
@pytest.mark.asyncio
async def test_times_in_messages_are_as_late_as_the_replay(topic: str, told: bool) -> None:
    make, content_type = KINDS.get(topic, (plot_048, "application/x-asterix"))
    recorded = [
        message(
            i * 300 * MS,
            topic,
            make(RECORDED + i * 300 * MS - 40 * MS),
            content_type=content_type if told else "",
            properties=attributes("p/radar", "x", str(i), RECORDED - 5),
        )
        for i in range(4)
    ]
    ears, totals = await simulated(recorded, ReplaySettings(stamps=Stamps(to_now=True)))
    assert len(ears.heard) == 4
    for i, (now_ns, got) in enumerate(ears.heard):
        time_ns = now_ns - 40 * MS
        if make is sapient:
            time_ns = time_ns // 1000 * 1000
        if make is plot_048:
            found = int.from_bytes(got.payload[6:9], "big")
            assert abs(found * S - time_ns % (86_400 * S) * 128) <= S  # an LSB
        else:
            assert got.payload == make(time_ns)
        shift_ns = now_ns - recorded[i].log_time_ns
        assert dict(got.properties)["time"] == iso_utc(RECORDED - 5 + shift_ns)
    assert not totals.left


@pytest.mark.asyncio
async def test_times_in_messages_are_left_alone_unless_asked() -> None:
    recorded = [message(0, topic, make(RECORDED), content_type=t) for topic, (make, t) in
                KINDS.items()]  # fmt: skip
    ears, _ = await simulated(recorded)
    assert ears.payloads() == [r.payload for r in recorded]
    shifted, _ = await simulated(recorded, ReplaySettings(stamps=Stamps.parse("+3600.25")))
    makes = [make for make, _ in KINDS.values()]
    assert shifted.payloads() == [make(RECORDED + 3600 * S + S // 4) for make in makes]


@pytest.mark.asyncio
async def test_telemetry_of_every_kind_is_as_late_as_its_replay() -> None:
    sample = pb.Telemetry(latitude_deg=1, longitude_deg=2, altitude_m=3, altitude_reference=1)
    sample.time_utc.FromNanoseconds(RECORDED)
    said = (sample.SerializeToString(), json_format.MessageToJson(sample).encode())
    recorded = [
        message(n * S, f"p/telemetry/{n}", payload, stage=Stage.TELEMETRY)
        for n, payload in enumerate(said)
    ]
    settings = ReplaySettings(stage="telemetry", stamps=Stamps(to_now=True))
    ears, totals = await simulated(recorded, settings)
    for (now_ns, got), was in zip(ears.heard, recorded, strict=True):
        assert decode_report(got.payload).t_utc_ns == RECORDED + now_ns - was.log_time_ns
    assert not totals.left


@pytest.mark.asyncio
async def test_what_cannot_be_moved_is_left_alone_counted_and_said_once(
    caplog: pytest.LogCaptureFixture,
) -> None:
    odd = bytes([247, 0, 4, 1])
    recorded = [
        message(0, "a/picture", b"\x89PNG", content_type="image/png"),
        message(1, "p/radar/asterix/247", odd),
        message(2, "p/radar/asterix/247", odd),
        message(3, "p/radar/plots", b"\xff\xff"),
        message(4, "p/radar/status", b"gone"),
        message(5, "p/radar/plots", plots(RECORDED), properties=(("time", "tomorrow"),)),
    ]
    ears, totals = await simulated(recorded, ReplaySettings(stamps=Stamps(by_ns=S)))
    assert ears.payloads()[:5] == [r.payload for r in recorded[:5]]
    assert ears.heard[5][1].properties == (("time", "tomorrow"),)
    assert sorted(totals.left.values()) == [1, 1, 1, 1, 2]
    assert len([r for r in caplog.records if "left alone" in r.message]) == 5
    left: Counter[str] = Counter()
    restamper = Restamper(left)
    for i in range(1000):  # a thousand ways to be left alone are not a thousand lines
        restamper.payload(message(0, f"a/{i}/status", b"{}"), S)
    assert left.total() == 1000
    assert len(caplog.records) < 30


@pytest.mark.parametrize(
    ("read", "text", "expected"),
    [
        (Stamps.parse, "keep", Stamps()),
        (Stamps.parse, "now", Stamps(to_now=True)),
        (Stamps.parse, "+3600", Stamps(by_ns=3600 * S)),
        (Stamps.parse, "-0.000000001", Stamps(by_ns=-1)),
        (moment_ns, "0", RECORDED),
        (moment_ns, "1.5", RECORDED + 3 * S // 2),
        (moment_ns, "2026-01-01T12:00:00.000000001Z", RECORDED + 1),
        (moment_ns, "2026-01-01T14:00:00+02:00", RECORDED),
        (TopicRule.parse, "a/b=n", TopicRule("a/b", "n")),
    ],
)
def test_what_is_asked_is_read_exactly(
    read: Callable[[str], object], text: str, expected: object
) -> None:
    assert read(text) == expected


@pytest.mark.parametrize(
    ("read", "text", "expected"),
    [
        *((Stamps.parse, wrong, "keep, now, or seconds")
          for wrong in ("", "later", "nan", "inf", "1e99", "1 s")),
        *((Moment.parse, wrong, "seconds from the beginning")
          for wrong in ("", "-1", "noon", "2026-01-01T12:00:00", "2026-13-01T00:00:00Z")),
        *((TopicRule.parse, wrong, "OLD=NEW")
          for wrong in ("a", "=b", "a=", "a=b+", "a=#", "a=\0", "a=" + "x" * 70_000)),
    ],
)  # fmt: skip
def test_what_cannot_be_asked_is_refused(
    read: Callable[[str], object], text: str, expected: str
) -> None:
    with pytest.raises(ReplayError, match=f"expected {expected}"):
        read(text)


@pytest.mark.parametrize(
    ("topic", "source"),
    [
        ("plotfeed/radar/asterix/048", "plotfeed/radar"),
        ("a/b/c/radar/plots", "a/b/c/radar"),
        ("a/radar/sapient", "a/radar"),
        ("foreign/feed/x/y", "foreign/feed"),
        ("one", "one"),
        ("udp/10.0.0.1/8600", "udp/10.0.0.1/8600"),
    ],
)
def test_a_source_is_what_stands_before_the_format(topic: str, source: str) -> None:
    assert source_of(topic) == source


LOSSY = LinkSettings.model_validate(
    {"latency_ms": 30.0, "jitter_ms": 10.0, "loss": {"kind": "random", "probability": 0.3}}
)


@pytest.mark.asyncio
async def test_the_same_seed_gives_the_same_losses_and_another_seed_others() -> None:
    recorded = [message(i * MS, "p/radar/plots") for i in range(300)]

    async def sent(seed: int, begin_utc_ns: int = REPLAYED) -> list[bytes]:
        settings = ReplaySettings(links=(LinkRule("", LOSSY),), seed=seed)
        return (await simulated(recorded, settings, begin_utc_ns=begin_utc_ns))[0].payloads()

    assert await sent(1) == await sent(1, REPLAYED + 123_456_789)
    assert set(await sent(1)) != set(await sent(2))


@pytest.mark.asyncio
async def test_links_are_for_the_topics_that_they_are_told() -> None:
    """What a session says of itself goes over none."""
    recorded = [message(i, t) for i, t in enumerate(["p/a/plots", "p/b/plots", "p/ab/plots"])]
    slow = LinkRule("p/a", LinkSettings(latency_ms=50.0))
    ears, _ = await simulated(recorded, ReplaySettings(links=(slow,)))
    assert [m.topic for _, m in ears.heard] == ["p/b/plots", "p/ab/plots", "p/a/plots"]
    assert ears.times() == [0, 1, 50 * MS - 1]
    topics = [f"p/radar/{kind}" for kind in ("status", "settings", "description", "plots")]
    recorded = [message(i, topic) for i, topic in enumerate(topics)]
    down = ReplaySettings(links=(LinkRule("", LinkSettings(down=True)),))
    ears, totals = await simulated(recorded, down)
    assert ([m.topic for _, m in ears.heard], totals.lost) == (topics[:3], 1)


@pytest.mark.asyncio
async def test_what_a_link_holds_arrives_in_a_pause_and_after_the_last_message() -> None:
    recorded = [message(i * 10 * MS, "p/radar/plots") for i in range(5)]
    settings = ReplaySettings(links=(LinkRule("", LinkSettings(latency_ms=1000.0)),))
    ears, _ = await simulated(recorded, settings)
    assert ears.times() == [i * 10 * MS for i in range(5)]


LINK = """
[sensor.link]
latency_ms = 40
jitter_ms = 15
duplicate = 0.1
loss = { kind = "gilbert-elliott", mean_loss = 0.2, mean_burst = 3 }
"""
REPORTS = 'report = ["asterix-048", "plots", "sapient"]'


@pytest.mark.asyncio
async def test_what_a_session_handed_to_its_links_meets_the_same_fate_on_the_same_links(
    tmp_path: Path,
) -> None:
    """Of two radars, one of them on a bad link; and as it left, where that is replayed."""
    bad = radar("far", period_s=0.5, more=REPORTS) + LINK
    text = scene_text(start_utc="2026-01-01T12:00:00.05Z", port=1883, sensors=radar("near") + bad)
    path, record = scene_file(tmp_path, text), tmp_path / "session.mcap"
    how = ["--broker", "none", "--speed", "max", "--duration", "10"]
    done = plotfeed("run", path, "--record", record, *how)
    assert done.returncode == 0, done.stderr
    with McapReader(record) as log:
        recorded = list(log.messages())
    scene = load(path)
    links = tuple(LinkRule(f"plotfeed/{s.id}", s.link) for s in scene.sensor if s.link)
    before = [r for r in recorded if r.stage is Stage.BEFORE]
    ears, totals = await simulated(
        recorded, ReplaySettings(stage="before", links=links, seed=scene.scene.seed)
    )
    begin_ns = min(r.publish_time_ns for r in before)
    # Status and registrations went past the link, and were not handed to it.
    handed = {(r.topic, r.payload) for r in before}
    after = [r for r in recorded if r.stage is Stage.AFTER and not r.topic.endswith("/truth")]
    assert totals.lost > 0
    assert totals.duplicated > 0
    replayed = [(t - REPLAYED - READY_NS, m.topic, m.payload) for t, m in ears.heard]
    left = [(r.log_time_ns - begin_ns, r.topic, r.payload) for r in after]
    assert sorted(replayed) == sorted(each for each in left if each[1:] in handed)
    ears, _ = await simulated(recorded)
    assert ears.times() == [r.log_time_ns - after[0].log_time_ns for r in after]
    for (_, got), was in zip(ears.heard, after, strict=True):
        for name in ("topic", "payload", "content_type", "properties", "retain"):
            assert getattr(got, name) == getattr(was, name)


# Over UDP, heard by an ordinary socket.

# Stands for any address, where only the other keys count.
ANYWHERE = UdpDestination(destination="239.0.0.0:1")


async def sent_over(
    outs: Sequence[Transport], recorded: Sequence[Recorded], settings: ReplaySettings | None = None
) -> ReplayCounters:
    running = Replayer(settings or ReplaySettings(speed=100)).run(Memory(recorded), outs)  # type: ignore[arg-type]
    return await asyncio.wait_for(running, PATIENCE_S)


def opened(to: str, **keys: object) -> ReplayUdp:
    link = ReplayUdp(UdpDestination.model_validate({"destination": to, **keys}))
    link.open()
    return link


@pytest.mark.parametrize("fastest", [False, True])
@pytest.mark.asyncio
async def test_the_same_octets_come_in_the_same_order(fastest: bool) -> None:
    """But of what is no datagram, which is counted."""
    recorded = datagrams(300, step_ns=MS)
    with receiver() as ears:
        link = opened(place(ears))
        others = [message(0, "p/radar/plots"), message(MS, "p/radar/status")]
        settings = ReplaySettings(fastest=fastest)
        totals = await sent_over([link], [others[0], *recorded, others[1]], settings)
        link.close()
        assert not link.send(b"x")
        assert heard(ears) == [r.payload for r in recorded]
    assert totals.messages == 300
    assert totals.octets == sum(len(r.payload) for r in recorded)
    assert (totals.undelivered, totals.skipped.total()) == (0, 2)


@pytest.mark.asyncio
async def test_datagrams_go_where_they_once_went_or_where_a_rule_says() -> None:
    host = "::1" if has_ipv6() else "127.0.0.1"  # without brackets in topics
    with receiver() as first, receiver(host) as second:
        topics = [
            f"udp/{at}/{ears.getsockname()[1]}"
            for at, ears in (("127.0.0.1", first), (host, second))
        ]
        recorded = [message(i * MS, topics[i % 2], bytes([i])) for i in range(10)]
        recorded.append(message(11 * MS, "udp/239.1.2.3/8600", b"x"))
        rule = TopicRule.parse(f"udp/239.1.2.3/8600={topics[0]}")
        out = RecordedUdp(ANYWHERE)
        totals = await sent_over(
            [out],
            [*recorded, message(0, "p/radar/asterix/048")],
            ReplaySettings(speed=Fraction(100), topics=(rule,)),
        )
        out.close()
        assert heard(first) == [*(bytes([i]) for i in range(0, 10, 2)), b"x"]
        assert heard(second) == [bytes([i]) for i in range(1, 10, 2)]
    assert (totals.messages, totals.skipped.total()) == (11, 1)


@pytest.mark.asyncio
async def test_a_destination_that_is_none_is_skipped_and_many_do_not_take_all_sockets() -> None:
    none = ("", "127.0.0.1", "127.0.0.1/0", "host/1", "0.0.0.0/1", "a/b/c")
    for topics, skipped in (
        ([f"udp/{wrong}" for wrong in none] * 2, 12),
        ([f"udp/127.0.0.1/{1024 + i}" for i in range(400)], 400 - 256),
    ):
        out = RecordedUdp(ANYWHERE)
        totals = await sent_over([out], [message(i, topic, b"x") for i, topic in enumerate(topics)])
        out.close()
        assert totals.skipped.total() == skipped
        assert totals.messages == len(topics) - skipped


@pytest.mark.asyncio
async def test_nobody_who_listens_is_counted_and_whoever_comes_then_misses_nothing() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as once:
        once.bind(("127.0.0.1", 0))
        port = once.getsockname()[1]
    link = opened(f"127.0.0.1:{port}")
    totals = await sent_over([link], datagrams(20))
    assert link.refused > 0
    assert (totals.messages, totals.undelivered) == (20, 0)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ears:
        ears.bind(("127.0.0.1", port))
        assert link.send(b"somebody")
        ears.settimeout(PATIENCE_S)
        assert ears.recv(100) == b"somebody"
    link.close()


@pytest.mark.asyncio
async def test_multicast_goes_to_its_group() -> None:
    with receiver(group="239.255.77.78") as ears:
        link = opened(place(ears), interface=LOOPBACK_INTERFACE, ttl=0)
        await sent_over([link], datagrams(3))
        link.close()
        assert heard(ears) == [r.payload for r in datagrams(3)]


@pytest.mark.asyncio
async def test_a_datagram_that_is_too_large_is_undelivered() -> None:
    """And an interface that is not there is named."""
    with receiver() as ears:
        link = opened(place(ears))
        totals = await sent_over(
            [link], [message(0, "udp/10.0.0.1/1", bytes(70_000)), *datagrams(1)]
        )
        link.close()
        assert len(heard(ears)) == 1
    assert (totals.messages, totals.undelivered) == (1, 1)
    with pytest.raises(TransportError, match=r"--udp.*no-such-interface"):
        opened("239.1.2.3:8600", interface="no-such-interface")


@pytest.mark.parametrize(
    ("topic", "content_type", "is_one"),
    [
        ("a/radar/asterix/048", "", True),
        ("a", "application/x-asterix; cat=48", True),
        ("udp/10.0.0.1/1", "", True),
        ("a/radar/plots", "application/x-protobuf", False),
        ("asterix/errors", "application/json", False),
    ],
)
def test_datagrams_are_known_by_type_or_topic(topic: str, content_type: str, is_one: bool) -> None:
    given = Message(topic=topic, payload=b"", content_type=content_type, due_utc_ns=0)
    link = ReplayUdp(UdpDestination(destination="127.0.0.1:1"))
    assert link.carries(given) == is_one
