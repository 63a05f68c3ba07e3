"""Captures as tshark reads them."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

from support.tools import needed


def tshark_fields(path: Path, *fields: str) -> list[list[str]]:
    """The fields of each packet, those that occur more than once joined by commas."""
    wanted = [word for field in fields for word in ("-e", field)]
    checks = [word for kind in ("udp", "ip") for word in ("-o", f"{kind}.check_checksum:TRUE")]
    done = subprocess.run(
        [needed("tshark"), "-n", "-r", str(path), *checks, "-T", "fields", *wanted],
        capture_output=True,
        text=True,
        check=True,
        timeout=120,
    )
    return [line.split("\t") for line in done.stdout.splitlines()]


def tshark_layers(path: Path) -> list[tuple[str, Any]]:
    """Every layer of every packet: its name, and the names and values of its tree, as pairs."""
    command = [needed("tshark"), "-n", "-r", str(path), "-T", "json"]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120)
    packets = json.loads(done.stdout, object_pairs_hook=list)
    return [layer for packet in packets for layer in dict(dict(packet)["_source"])["layers"]]
