"""The sensors that a scene can name: the keys of each, and the model that they make."""
