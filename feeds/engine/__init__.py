"""A scene as a function: what comes in and time, in; batches of messages, out.

No socket, clock, task or file: sessions, simulations, sweeps and parts of fleets drive the same
`Engine`. The physics is in `models`; how messages leave is the session's.
"""
