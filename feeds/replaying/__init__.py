"""A recording sent again: in its order, at its times, to where it is asked for.

Reading files is in `replay`; what is in the messages is only looked at to move their times.
"""
