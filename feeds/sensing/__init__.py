"""Sensors at work on arrays: where they stand, how they look, and what a sector brings.

The physics is in `models`; when a sector is due and where its messages go is the session's.
"""
