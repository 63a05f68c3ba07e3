"""Where a beam is when: scans, sectors, cover, and which drones it meets."""
