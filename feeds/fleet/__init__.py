"""One scene over many processes or hosts: which sensors are whose, and what starts the processes.

What a process does with its part is a session like any other and belongs to `session`.
"""
