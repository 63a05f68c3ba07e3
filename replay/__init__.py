"""Recordings: containers of messages, read and written without I/O of their own."""
