"""Preflight checks: what a pilot checks before a takeoff."""
