"""Calibration of a real camera: its intrinsics, from views of a board, and its delay, from the gyro."""
