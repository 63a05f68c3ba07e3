"""Tracks of sensors that track on board: the truth with a filter's errors, and their lives."""
