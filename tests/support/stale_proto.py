"""Fails if the committed protobuf modules are not what the schema gives; run by `make lint`."""

from __future__ import annotations

import sys
import tempfile
from importlib.resources import files
from pathlib import Path

from grpc_tools import protoc

PROTO = Path(__file__).resolve().parents[2] / "proto"
SCHEMAS = ("plotfeed", "ledger")
GENERATED = tuple(f"{name}_pb2.{suffix}" for name in SCHEMAS for suffix in ("py", "pyi"))


def generate(folder: Path) -> None:
    """Make the modules from the schemas, in plotfeed/proto below a folder."""
    code = protoc.main(
        [
            "protoc",
            f"--proto_path=plotfeed/proto={PROTO}",
            f"--proto_path={files('grpc_tools') / '_proto'}",
            f"--python_out={folder}",
            f"--pyi_out={folder}",
            *(f"plotfeed/proto/{name}.proto" for name in SCHEMAS),
        ]
    )
    if code:
        sys.exit("proto/*.proto: protoc does not take them")


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
