"""What is published for people and generators: schemas of the scene and of messages, and all flows.

What flows, on which topic and when, is told once here and said on by the AsyncAPI document.
"""
