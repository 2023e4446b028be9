"""Planning of area coverages: which ground is swept, along which path, how fast. Geometry in metres, [north, east]."""
