"""The commercial sensors of the paper's tables, one file each."""
