"""From the bytes that drones and files send to reports of positions, checked and admitted.

Where a drone is between its reports is worked out in `models.truth`, not here.
"""
