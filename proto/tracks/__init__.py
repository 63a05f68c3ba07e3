"""Tracks as systems beyond ASTERIX read them: a module a format, each from the same columns.

No sockets, no clocks; ASTERIX 062 is in `proto.asterix`.
"""
