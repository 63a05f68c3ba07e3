"""The native log, MCAP: records, chunks, channels and index, read and written."""
