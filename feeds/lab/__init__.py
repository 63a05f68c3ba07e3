"""What is worked out of recordings, feeds and trackers: reports, scores, sweeps, charts, verdicts.

A recording is read by one reader (`evidence`); what is told of it is tables and pictures. Sessions
load nothing of this: only the command line and the page import it.
"""
