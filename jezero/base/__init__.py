"""What the rest is built on: frames, geometry, messages as bytes, settings, the robot. It imports schemas only."""
