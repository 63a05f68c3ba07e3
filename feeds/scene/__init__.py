"""Every key that a scene may have, validated, and nothing else: no clock, no socket.

A scene is read from TOML into one frozen `Scene`; sensors, presets and examples have rooms within.
"""
