"""Protobuf schemas for the native log: so that other tools can decode what is in it."""

from __future__ import annotations

import contextlib
from importlib import import_module

from google.protobuf.descriptor import FileDescriptor
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.descriptor_pool import Default

MODULES = {
    "plotfeed.v1.": "plotfeed.proto.plotfeed_pb2",
    "sapient_msg.bsi_flex_335_v2_0.": "sapient_msg.bsi_flex_335_v2_0.sapient_message_pb2",
}
"""Of packages: what brings their messages along, if it is installed."""


def schema_of(message_type: str) -> bytes | None:
    """A FileDescriptorSet with that message and all it needs; None if it is not known here."""
    for package, module in MODULES.items():
        if message_type.startswith(package):
            with contextlib.suppress(ImportError):
                import_module(module)
    try:
        message = Default().FindMessageTypeByName(message_type)
    except KeyError:
        return None
    files: dict[str, FileDescriptor] = {}
    _collect(message.file, files)
    found = FileDescriptorSet()
    for file in files.values():
        file.CopyToProto(found.file.add())
    return found.SerializeToString(deterministic=True)


def _collect(file: FileDescriptor, files: dict[str, FileDescriptor]) -> None:
    """Dependencies come before what needs them."""
    if file.name not in files:
        for needed in file.dependencies:
            _collect(needed, files)
        files[file.name] = file
