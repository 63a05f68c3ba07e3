"""A flight, a radar, a tracker and a UTM system, from end to end in one command.

The UTM system is a stub that takes Flight Blender's air traffic as the real one does: by its
schema, with a bearer token, 201 for what is queued and 422 for what is not as it must be.

    .venv/bin/python examples/utm_end_to_end.py [SECONDS]
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import threading
from collections import Counter
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any, ClassVar

SCENE = Path(__file__).parent / "scenes" / "utm.toml"
PATH = re.compile(r"/flight_stream/set_air_traffic/[0-9a-f-]{36}")
TOKEN = "of-the-example"  # noqa: S105 - nobody else has it
LIMITS = {
    "lat_dd": (-90.0, 90.0),
    "lon_dd": (-180.0, 180.0),
    "altitude_mm": (-1e6, 1e8),
    "traffic_source": (0, 11),
    "source_type": (0, 1),
}


def problem_of(body: Any) -> str:
    """What is wrong with a body of set_air_traffic; empty if nothing is."""
    if not isinstance(body, dict) or not isinstance(body.get("observations"), list):
        return "no list of observations"
    for each in body["observations"]:
        for key, (least, most) in LIMITS.items():
            value = each.get(key)
            if not isinstance(value, int | float) or not least <= value <= most:
                return f"{key} is {value!r}"
        if not isinstance(each.get("icao_address"), str) or len(each["icao_address"]) > 24:
            return f"icao_address is {each.get('icao_address')!r}"
        if not isinstance(each.get("metadata", {}), dict):
            return f"metadata is {each['metadata']!r}"
        for key in ("traffic_source", "source_type", "timestamp"):
            if type(each.get(key)) is not int:
                return f"{key} is {each.get(key)!r}"
    return ""


class Utm(BaseHTTPRequestHandler):
    """Takes air traffic, and tells of every track when it is first heard of."""

    protocol_version = "HTTP/1.1"
    heard: ClassVar[Counter[str]] = Counter()

    def do_POST(self) -> None:
        """Answer as Flight Blender does."""
        octets = self.rfile.read(int(self.headers["Content-Length"]))
        if self.headers["Authorization"] != f"Bearer {TOKEN}":
            self.answer(401, "no such token")
        elif not PATH.fullmatch(self.path):
            self.answer(404, "no such address")
        elif problem := problem_of(json.loads(octets)):
            self.answer(422, problem)
        else:
            for each in json.loads(octets)["observations"]:
                self.take(each)
            self.answer(201, "queued")

    def take(self, observation: dict[str, Any]) -> None:
        """Print what is new."""
        track = observation["icao_address"]
        self.heard[track] += 1
        ends = observation["metadata"]["last"]
        if self.heard[track] == 1 or ends:
            print(
                f"track {track} {'ends' if ends else 'begins'} at {observation['lat_dd']:.6f} "
                f"{observation['lon_dd']:.6f} {observation['altitude_mm'] / 1000:.0f} m",
                flush=True,
            )

    def answer(self, status: int, text: str) -> None:
        """Say it in JSON."""
        octets = json.dumps({"message": text}).encode()
        self.send_response(status)
        self.send_header("Content-Length", str(len(octets)))
        self.end_headers()
        self.wfile.write(octets)
        if status != 201:
            print(f"refused with {status}: {text}", flush=True)

    def log_message(self, *_: object) -> None:
        """Nothing: a line a post is too many."""


def main() -> int:
    """Run the scene against the stub; 0 if a track of the drone came, and nothing was refused."""
    seconds = sys.argv[1] if len(sys.argv) > 1 else "60"
    server = ThreadingHTTPServer(("127.0.0.1", 0), Utm)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    address = f"http://127.0.0.1:{server.server_address[1]}"
    to = f"air-traffic={address}/flight_stream/set_air_traffic/{{session}}"
    command = [sys.executable, "-m", "plotfeed.feeds.cli", "run", str(SCENE), "--broker", "none"]
    command += ["--http", to, "--duration", seconds, "--speed", "4"]
    environment = {**os.environ, "PLOTFEED_HTTP_TOKEN_COMMAND_LINE": TOKEN}
    done = subprocess.run(  # noqa: S603 - our own command
        command, env=environment, capture_output=True, text=True, check=False
    )
    server.shutdown()
    print(done.stdout.splitlines()[-1] if done.stdout else done.stderr)
    tracks = ", ".join(f"{track} {count} times" for track, count in Utm.heard.most_common())
    print(f"the UTM system heard of {tracks or 'nothing'}")
    return 0 if Utm.heard and done.returncode == 0 else 1


if __name__ == "__main__":
    sys.exit(main())
