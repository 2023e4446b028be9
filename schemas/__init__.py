"""The contract between processes: every key, message, unit, frame and range. Imports only msgspec."""
