"""Runs the services of a compose file as plain local processes and never leaves one behind."""
