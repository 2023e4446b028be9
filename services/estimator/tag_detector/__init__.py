"""Finds the landing tags in the camera's pictures and tells where the vehicle is relative to them."""
