"""The faulty-plant simulator: hydraulics, drive, friction, oil, sensors, controllers, scenarios."""
