"""When a sensor looks where: scans, sectors and cover, which drones a beam meets, whose draws."""
