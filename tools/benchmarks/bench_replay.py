"""How exactly a recording is replayed, beside C and ast-tool-py, and how fast without deadlines.

    python tools/benchmarks/bench_replay.py [repeats]

The recording is the ASTERIX of eight rotating radars, as a pcap that both read. Both send it by UDP
over loopback to a process that has the kernel stamp each datagram as it comes. ast-tool-py runs in
`.venv-ast-tool`, which is made where it is missing, and sends as its documentation says, through a
pipe. The player in C has all in memory, sleeps by clock_nanosleep with a timer slack of 1 ns and
calls sendto: what the machine itself can do. Errors are reckoned from the datagram that came
earliest beside its recorded time.
"""

from __future__ import annotations

import contextlib
import json
import socket
import statistics
import struct
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from aims import python_with, ratios, spread

PROJECT = Path(__file__).parents[2]
OTHER = ".venv-ast-tool"
IN_C = "clock_nanosleep and sendto in C"
AST_TOOL = "ast-tool-py==0.27.25"
SECONDS, DRIFT_SECONDS = 12.0, 40.0
REPEATS = 3
UNPACED = {100: 100_000, 1400: 50_000}
HOST = "127.0.0.1"
SO_TIMESTAMPNS, SO_RCVBUFFORCE = 35, 33  # Of Linux, and unknown to Python
SILENCE_S = 3.0
S = 1_000_000_000
# It reads of each datagram: nanoseconds after the first, octets, and these, filled up to 8.
PLAYER_C = r"""
#include <arpa/inet.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <time.h>
static const int64_t S = 1000000000, READY_NS = 20000000;
int main(int n_arguments, char **arguments) {
    if (n_arguments != 3) return 2;
    FILE *file = fopen(arguments[1], "rb");
    fseek(file, 0, SEEK_END);
    long octets = ftell(file);
    rewind(file);
    char *all = malloc(octets);
    if (fread(all, 1, octets, file) != (size_t)octets) return 3;
    int way_out = socket(AF_INET, SOCK_DGRAM, 0);
    struct sockaddr_in to = {.sin_family = AF_INET, .sin_port = htons(atoi(arguments[2]))};
    to.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    prctl(PR_SET_TIMERSLACK, 1UL);
    struct timespec due;
    clock_gettime(CLOCK_MONOTONIC, &due);
    int64_t begin_ns = due.tv_sec * S + due.tv_nsec + READY_NS;
    for (char *at = all; at < all + octets;) {
        int64_t after_ns = ((int64_t *)at)[0], length = ((int64_t *)at)[1];
        due.tv_sec = (begin_ns + after_ns) / S;
        due.tv_nsec = (begin_ns + after_ns) % S;
        clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &due, NULL);
        sendto(way_out, at + 16, length, 0, (struct sockaddr *)&to, sizeof to);
        at += 16 + (length + 7) / 8 * 8;
    }
    return 0;
}
"""


def listen(result_file: Path, count: int) -> None:
    """In a process of its own: says its port, and keeps the kernel's time of each datagram."""
    import numpy as np

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ears:
        ears.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        for option in (socket.SO_RCVBUF, SO_RCVBUFFORCE):
            with contextlib.suppress(OSError):
                ears.setsockopt(socket.SOL_SOCKET, option, 64 << 20)
        ears.bind((HOST, 0))
        print(ears.getsockname()[1], flush=True)
        times: list[int] = []
        ears.settimeout(60)
        with contextlib.suppress(TimeoutError):
            while len(times) < count:
                _, stamps, _, _ = ears.recvmsg(2048, 64)
                seconds, ns = struct.unpack_from("qq", stamps[0][2])
                times.append(seconds * S + ns)
                if len(times) in (1, count // 2):
                    ears.settimeout(SILENCE_S)
    np.save(result_file, times)


class Listener:
    """That process."""

    def __init__(self, folder: Path, count: int) -> None:
        self._result = folder / "times.npy"
        arguments = [sys.executable, __file__, "listen", self._result, count]
        self._process = subprocess.Popen([str(a) for a in arguments], stdout=subprocess.PIPE)
        assert self._process.stdout is not None
        self.port = int(self._process.stdout.readline())

    def times_ns(self) -> Any:
        """When each datagram came, once it has been silent for a while."""
        import numpy as np

        self._process.communicate(timeout=120)
        return np.load(self._result)


def recorded(seconds: float) -> list[Any]:
    """ASTERIX of radars that turn at eight speeds, 32 sectors a turn, each when it is due."""
    from plotfeed.replay.recorded import Recorded
    from plotfeed.testing import flown, fly, radar, rotating, scene, waypoint

    radars = [radar(id=f"radar{i}", scan=rotating(0.9 + i / 10, 32)) for i in range(8)]
    drone = flown("visitor", waypoint(60.0, 5.0, 1700.0), waypoint(320.0, 5.0, 1500.0))
    sent = fly(scene(radars, [drone], seed=3), seconds).messages
    found = [
        Recorded(
            topic=f"udp/{HOST}/8600",
            payload=message.payload,
            log_time_ns=message.due_utc_ns,
            publish_time_ns=message.due_utc_ns,
            content_type=message.content_type,
        )
        for message in sent
        if message.content_type.startswith("application/x-asterix")
    ]
    return sorted(found, key=lambda r: r.log_time_ns)


def pcap(path: Path, messages: Sequence[Any]) -> Path:
    """A file of them, and beside it one for the player in C."""
    from plotfeed.replay.pcap import PcapWriter

    with path.open("wb") as file:
        writer = PcapWriter(file)
        for each in messages:
            writer.write(each)
        writer.close()
    with path.with_suffix(".datagrams").open("wb") as file:
        for each in messages:
            octets = len(each.payload)
            file.write(struct.pack("<qq", each.log_time_ns - messages[0].log_time_ns, octets))
            file.write(each.payload.ljust((octets + 7) // 8 * 8, b"\0"))
    return path


def mcap(path: Path, octets: int, count: int) -> Path:
    """A log of that many messages, 20,000 a second."""
    from plotfeed.replay.mcap import McapWriter
    from plotfeed.replay.recorded import Recorded

    body = bytes(range(256)) * 8
    with path.open("wb", buffering=0) as file:
        writer = McapWriter(file)
        for i in range(count):
            t_ns = 1_767_268_800 * S + i * 50_000
            payload = i.to_bytes(8, "big") + body[: octets - 8]
            writer.write(
                Recorded(
                    topic="plotfeed/radar/asterix/048",
                    payload=payload,
                    log_time_ns=t_ns,
                    publish_time_ns=t_ns,
                    content_type="application/x-asterix; cat=48",
                )
            )
        writer.close()
    return path


def replayed(path: Path, *options: str) -> dict[str, Any]:
    """What a replay with those options counts."""
    command = [sys.executable, "-m", "plotfeed.feeds.cli", "replay", str(path), "--json"]
    out = subprocess.run([*command, *options], check=True, stdout=subprocess.PIPE).stdout
    counts: dict[str, Any] = json.loads(out)
    return counts


def by_plotfeed(path: Path, port: int) -> None:
    """Replay it."""
    replayed(path, "--udp", f"{HOST}:{port}")


def by_ast_tool(path: Path, port: int, *more: str) -> None:
    """The same, by two processes and a pipe."""
    tool = PROJECT / OTHER / "bin" / "ast-tool-py"
    player = subprocess.Popen(
        [tool, "replay", "--format", "pcap", *more, path], stdout=subprocess.PIPE
    )
    sender = [tool, "to-udp", "--unicast", "*", HOST, str(port)]
    subprocess.run(sender, check=False, stdin=player.stdout)
    assert player.stdout is not None
    player.stdout.close()
    player.wait()


def by_c(path: Path, port: int) -> None:
    """The same by clock_nanosleep and sendto."""
    from beside import compiled

    program = compiled(PLAYER_C, "player")
    assert program is not None
    subprocess.run([program, path.with_suffix(".datagrams"), str(port)], check=True)


def players() -> dict[str, Callable[..., Any]]:
    """Who replays, in turns; C where there is a compiler."""
    from support.tools import place_of

    by_compiler = {IN_C: by_c} if place_of("cc") else {}
    return {"plotfeed": by_plotfeed, **by_compiler, "ast-tool-py": by_ast_tool}


def errors_us(messages: Sequence[Any], times_ns: Any) -> Any:
    """How much later each datagram came than the recording has it."""
    import numpy as np

    if len(times_ns) != len(messages):
        raise RuntimeError(f"{len(times_ns)} datagrams came of {len(messages)}")
    late_ns = times_ns - np.array([m.log_time_ns for m in messages])
    return (late_ns - late_ns.min()) / 1e3


def by_turns(
    file: Path, messages: Sequence[Any], repeats: int, told: Callable[[Any], Any]
) -> dict[str, list[Any]]:
    """What is told of the errors of each player, microseconds, run by run."""
    found: dict[str, list[Any]] = {name: [] for name in players()}
    for _ in range(repeats):
        for name, play in players().items():
            listener = Listener(file.parent, len(messages))
            play(file, listener.port)
            found[name].append(told(errors_us(messages, listener.times_ns())))
    return found


def exactness(folder: Path, messages: Sequence[Any], repeats: int) -> None:
    """Prints the table of timing errors."""
    import numpy as np

    found = by_turns(
        pcap(folder / "short.pcap", messages),
        messages,
        repeats,
        lambda errors: [*np.percentile(errors, (50, 99)), errors.max()],
    )
    print(f"Timing error, µs: median (least to most) of {repeats} runs in turns of a recording of "
          f"{SECONDS:g} s,\n{len(messages)} datagrams. {AST_TOOL}.\n")  # fmt: skip
    print("| | p50 | p99 | most |\n|---|--:|--:|--:|")
    for name, runs in found.items():
        print(
            f"| {name} | "
            + " | ".join(_spread(column) for column in zip(*runs, strict=True))
            + " |"
        )
    for name, others in found.items():
        if name != "plotfeed":
            p50, p99, _ = (
                spread(ratios(a, b))
                for a, b in zip(zip(*found["plotfeed"], strict=True), zip(*others, strict=True),
                                strict=True)
            )  # fmt: skip
            print(f"\nOf {name}'s, by turns, plotfeed's p50 is {p50} times as much, its p99 {p99}.")


def drift(folder: Path, messages: Sequence[Any], repeats: int) -> None:
    """Prints how much later the last seconds came than the first."""
    import numpy as np

    print("\nDrift: median error of the last 5 s less that of the first 5, of a recording of "
          f"{DRIFT_SECONDS:g} s,\nµs: median (least to most) of {repeats} runs.\n")  # fmt: skip
    print("| | drift |\n|---|--:|")
    few = sum(m.log_time_ns < messages[0].log_time_ns + 5 * S for m in messages)
    found = by_turns(
        pcap(folder / "long.pcap", messages),
        messages,
        repeats,
        lambda errors: float(np.median(errors[-few:]) - np.median(errors[:few])),
    )
    for name, drifts in found.items():
        print(f"| {name} | {spread(drifts, '.1f')} |", flush=True)


def rates(folder: Path, messages: Sequence[Any], repeats: int) -> None:
    """Prints the messages a second without deadlines."""
    print(f"\nWithout deadlines, thousand messages a second: median (least to most) of {repeats} "
          "runs.\nOurs is from MCAP, by its own count of messages and time; ast-tool-py's is from "
          "the first to\nthe last datagram of a pcap.\n")  # fmt: skip
    print("| | octets | over | messages/s | × ast-tool-py's |\n|---|--:|---|--:|--:|")
    theirs = at_full_speed(folder, messages, repeats)
    for octets, count in UNPACED.items():
        file = mcap(folder / f"{octets}.mcap", octets, count)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as deaf:
            deaf.bind((HOST, 0))
            way = "--udp", f"{HOST}:{deaf.getsockname()[1]}", "--speed", "max"
            runs = [replayed(file, *way) for _ in range(repeats)]
        print(f"| plotfeed | {octets} | UDP | {_rate(runs, theirs)} |", flush=True)
        for broker, url in brokers(folder):
            runs = [replayed(file, "--broker", url, "--speed", "max") for _ in range(repeats)]
            print(f"| plotfeed | {octets} | MQTT, {broker} | {_rate(runs, theirs)} |", flush=True)
    mean = statistics.mean(len(m.payload) for m in messages)
    print(f"| ast-tool-py | {mean:.0f} | UDP | {_spread(theirs)} | |")


def at_full_speed(folder: Path, messages: Sequence[Any], repeats: int) -> list[float]:
    """Thousand messages a second of ast-tool-py."""
    file, found = pcap(folder / "short.pcap", messages), []
    for _ in range(repeats):
        listener = Listener(folder, len(messages))
        by_ast_tool(file, listener.port, "--full-speed")
        times_ns = listener.times_ns()
        found.append((len(times_ns) - 1) / (int(times_ns[-1] - times_ns[0]) / S) / 1e3)
    return found


def brokers(folder: Path) -> Iterator[tuple[str, str]]:
    """The embedded one, and mosquitto where it is installed."""
    from support.brokers import free_port, mosquitto, own_broker

    port = free_port()
    with own_broker(folder, port):
        yield "embedded", f"mqtt://{HOST}:{port}"
    port = free_port()
    try:
        with mosquitto(folder, port):
            yield "mosquitto", f"mqtt://{HOST}:{port}"
    except BaseException as error:
        if type(error).__name__ != "Skipped":  # pytest's, which is no Exception
            raise


def _rate(runs: Sequence[dict[str, Any]], theirs: Sequence[float]) -> str:
    each = [run["messages"] / run["duration_s"] / 1e3 for run in runs]
    return f"{_spread(each)} | {spread(ratios(each, theirs), '.1f')}"


def _spread(values: Sequence[float]) -> str:
    middle = statistics.median(values)
    digits = 0 if middle >= 100 else 1
    return f"{middle:,.{digits}f} ({min(values):,.{digits}f} to {max(values):,.{digits}f})"


def main(repeats: int) -> None:
    """Measures and prints."""
    python_with(OTHER, AST_TOOL)
    with tempfile.TemporaryDirectory() as folder:
        long = recorded(DRIFT_SECONDS)
        short = [m for m in long if m.log_time_ns < long[0].log_time_ns + SECONDS * S]
        exactness(Path(folder), short, repeats)
        drift(Path(folder), long, repeats)
        rates(Path(folder), short, repeats)


if __name__ == "__main__":
    if sys.argv[1:2] == ["listen"]:
        listen(Path(sys.argv[2]), int(sys.argv[3]))
    else:
        main(int(sys.argv[1]) if sys.argv[1:] else REPEATS)
