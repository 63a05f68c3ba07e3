"""Fails if the committed protobuf modules are not what the schema gives; run by `make lint`."""

from __future__ import annotations

import sys
import tempfile
from importlib.resources import files
from pathlib import Path

from grpc_tools import protoc

PROTO = Path(__file__).resolve().parents[2] / "proto"
GENERATED = ("plotfeed_pb2.py", "plotfeed_pb2.pyi")


def generate(folder: Path) -> None:
    """Make the modules from plotfeed.proto, in plotfeed/proto below a folder."""
    code = protoc.main(
        [
            "protoc",
            f"--proto_path=plotfeed/proto={PROTO}",
            f"--proto_path={files('grpc_tools') / '_proto'}",
            f"--python_out={folder}",
            f"--pyi_out={folder}",
            "plotfeed/proto/plotfeed.proto",
        ]
    )
    if code:
        sys.exit("proto/plotfeed.proto: protoc does not take it")


def stale(folder: Path) -> list[str]:
    """Which committed modules differ from those made in a folder."""
    return [
        name
        for name in GENERATED
        if (folder / "plotfeed" / "proto" / name).read_bytes() != (PROTO / name).read_bytes()
    ]


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as made:
        generate(Path(made))
        if names := stale(Path(made)):
            sys.exit(f"{' and '.join(names)} in proto/ are out of date: run 'make proto'")
