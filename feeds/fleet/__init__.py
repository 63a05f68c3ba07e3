"""One scene over many processes or hosts: who owns which sensor, who watches, who takes over.

What a worker does with its sensors is a session like any other and belongs to `session`.
"""
