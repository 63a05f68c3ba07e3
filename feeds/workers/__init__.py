"""Work spread over processes and hosts by Ray: joining it, and handing jobs out.

No word of sensors or scores: what a job is, the rooms above say.
"""
