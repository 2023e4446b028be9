"""What a flight leaves behind: its log, and plots that people can read."""
