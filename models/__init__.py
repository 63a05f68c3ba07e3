"""The physics: arrays in, arrays out; no I/O, no clock, no logging, no globals.

At the top: `state`, the structures of arrays that cross rooms, `truth`, where drones are, `frames`,
`propagation`, scans and rotating beams in `beam`, `detection` and what it rests on,
`accuracy`, trackers on board in `tracks`, `smoothing` of flights that were recorded, `chance` and
`numerics`. The models themselves are in `sensors`, what they may model besides in `effects`.
"""
