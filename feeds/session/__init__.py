"""A scene at work in real or simulated time: the loop, its sensors, what comes in and goes out.

Whoever wants to follow a session is an `Observer`; none of them is known here by name.
"""
