"""The physics: arrays in, arrays out; no I/O, no clock, no logging, no globals."""
