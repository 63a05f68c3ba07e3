"""Clocks, timers and the schedule: when something is due, and waiting exactly until then.

Time is nanoseconds of UTC everywhere. What is done at that time is no concern of this room.
"""
