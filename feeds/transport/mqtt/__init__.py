"""MQTT to one broker: its address, a connection kept up."""
