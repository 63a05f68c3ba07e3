"""What a sensor models only if it is asked to: each effect a small function of arrays."""
