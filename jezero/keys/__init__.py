"""Certificates of a team's computers and people: the authority that issues them, and how Zenoh uses them."""
