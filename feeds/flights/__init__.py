"""Flights from files: each reader gives telemetry reports."""
