"""Speed against accuracy: the methods of every stage, measured for a scene on this machine.

Methods that exist only to be compared stand here, and no session imports them.
"""
