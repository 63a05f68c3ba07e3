"""MCAP, in which everything that a message has is kept: records, chunks, channels and index."""
