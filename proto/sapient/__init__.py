"""SAPIENT, BSI Flex 335 v2.0: values in, bytes out, by the message classes of sapient-proto.

They are an extra: nothing outside this folder imports it until a scene or a message asks for it.
"""
