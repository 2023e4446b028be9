"""The driver of a real UWB module, which takes the place of the simulated ranges."""
