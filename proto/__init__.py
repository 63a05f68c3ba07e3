"""Bytes to values and back, pure: ASTERIX, SAPIENT and plotfeed's own protobuf messages."""
