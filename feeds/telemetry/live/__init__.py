"""Reports from what aircraft and those who hear them say, in protocols of others, as it comes.

Pure: octets and the time at which they came give reports. Sockets are in `feeds.transport`.
"""
