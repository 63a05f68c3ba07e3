"""Metrics of tracks and residuals of plots: arrays of truths and estimates in, figures out.

No files, topics or scenes: `feeds/score` reads those.
"""
