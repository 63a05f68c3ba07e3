"""What a tracker made of a feed: its tracks beside the ledger's truth, and a verdict.

The mathematics is in `models/scoring`; figures of the feed itself belong to `report`.
"""
