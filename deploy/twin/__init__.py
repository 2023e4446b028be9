"""The twin: simulator and autopilot behind the plugs that real hardware has, to rehearse before propellers turn."""
