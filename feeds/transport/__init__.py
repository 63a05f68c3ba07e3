"""The protocols that carry messages: MQTT, UDP, SAPIENT over TCP, and the broker of our own.

A transport takes deliveries and says what became of each; it never looks into a payload.
"""
