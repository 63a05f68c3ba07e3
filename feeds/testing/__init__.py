"""What users need in tests of their own trackers: scenes, feeds, a broker, a receiver.

`plotfeed.testing` shows what is defined here; what only plotfeed's own tests need is not. Nothing
of the product imports this room.
"""
