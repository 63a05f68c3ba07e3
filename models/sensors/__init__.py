"""The sensors of the paper, on what they share.

That is `sensor_model`, for all, and `polar_radar`, for radars. A new sensor is a
`SensorModel`, or a `CellSensor` where resolution cells alarm.
"""
