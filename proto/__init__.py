"""Bytes to values and back, pure: ASTERIX and plotfeed's own protobuf messages."""
