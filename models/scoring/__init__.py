"""Metrics of tracks beside the truth: arrays in, figures out.

What a file, a message or a profile is belongs to `feeds/score`.
"""
