"""The live page: a session or a recording as a plan-position display in a browser, with controls.

It follows a session as an `Observer` and asks for changes as anybody may on the control topic.
Nothing is worked out here that the feed does not hold; how it looks is in `static`.
"""
