"""Landing benchmark: many landings in virtual time, and their accuracy."""
