"""Recordings made, shown and turned into other formats; what a session's own recording holds.

Containers of files are in `replay`; sending a recording again is in `replaying`.
"""
