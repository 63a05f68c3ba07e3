"""Many seeded runs of a scene in simulated time, with one or more of its keys varied.

What one run gives belongs to the simulation; how runs are spread, to `workers`.
"""
