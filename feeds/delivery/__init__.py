"""What becomes of each message after its sensor reported it: its link, its copies.

Which protocol carries it is the transports' concern; what the link draws is impairment's.
"""
