"""The commercial systems of several sensors of section 2.6 of the paper, one file each."""
