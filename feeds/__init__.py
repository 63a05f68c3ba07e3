"""Everything that waits, listens or sends; what is public stands in `plotfeed`."""
