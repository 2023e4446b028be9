"""Replays of services: the service that was recorded, made again, on its recorded inputs."""
