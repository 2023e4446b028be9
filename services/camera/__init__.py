"""The driver of a real camera."""
