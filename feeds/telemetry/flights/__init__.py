"""Flights from files: each reader gives telemetry reports."""

from plotfeed.feeds.telemetry.flights.flight import Flight, FlightOptions, GpsOrder
from plotfeed.feeds.telemetry.flights.read import read
from plotfeed.feeds.telemetry.flights.smoothed import smoothed

__all__ = ["Flight", "FlightOptions", "GpsOrder", "read", "smoothed"]
