"""Reports of positions from the bytes that drones and files send, checked and admitted.

Where a drone is between its reports is worked out in `models.truth`, not here.
"""
