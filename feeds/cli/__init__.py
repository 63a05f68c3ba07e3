"""What a person types: commands, their options, and what becomes of them in a terminal.

Commands parse, call one function of a room below, and print. Nothing here is imported by any other
room, and nothing that only one command needs is imported before that command runs.
"""
