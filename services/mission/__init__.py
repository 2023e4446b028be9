"""Missions: flies a list of goals as a client of the actions."""
