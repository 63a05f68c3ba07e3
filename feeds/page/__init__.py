"""The live page: a session as a plan-position display in a browser, with its controls."""
