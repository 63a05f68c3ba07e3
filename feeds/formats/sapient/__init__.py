"""SAPIENT: what a node says of itself and its detections, and how it reaches a middleware."""
