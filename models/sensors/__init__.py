"""The sensors of the paper: looks in, plots and false alarms out, each by its equations."""
