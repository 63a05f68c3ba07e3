"""The example scenes that come with plotfeed."""
