"""How a service runs: over Zenoh in real time, or on an in-memory bus in virtual time."""
