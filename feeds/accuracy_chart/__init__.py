"""Speed against accuracy: the methods of every stage, measured for a scene on a machine."""
