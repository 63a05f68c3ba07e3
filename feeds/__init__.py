"""Everything that waits, listens or sends."""
