"""A scene as a function: what comes in and time, in; batches of messages, out.

No socket, clock, task or file: sessions, simulations, sweeps and parts of fleets drive the same
`Engine`. Where sensors look and what they find is sensing's; how messages leave is the session's.
"""
