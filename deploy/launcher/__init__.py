"""Launcher: runs the services of a compose file as local processes and leaves none behind."""
