"""A terminal's and a process's manners: signals, progress, a file that is whole or not there.

Nothing here knows of sensors, messages or sessions.
"""
