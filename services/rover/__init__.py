"""The rover's own computer in a simulation."""
