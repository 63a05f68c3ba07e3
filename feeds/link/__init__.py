"""What becomes of each message after its sensor reported it: its link, its copies, the ledger.

Which protocol carries it is the transports' concern. Nothing here reads a socket or a clock of its
own.
"""
