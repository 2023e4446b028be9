"""Many landings in virtual time, and how well they went."""
