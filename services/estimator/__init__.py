"""Where the vehicle is relative to the rover: UWB positioning, and the Kalman filter that fuses it with the rest."""
