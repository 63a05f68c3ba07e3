"""A message as everything that carries one sees it: payload, topic, content type, times.

Not what is in it (formats), nor what becomes of it (impairment, delivery).
"""
