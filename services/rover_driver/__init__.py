"""The driver of a real rover, which takes the place of the simulated one: odometry in, drive commands out."""
