"""What a command's exit code tells; 0 is success."""

FAILED = 1
"""Something went wrong that none of the others says."""
USAGE = 2
"""The command line itself is wrong (click's own code)."""
REFUSED = 3
"""The vehicle, or a stack that is up already, said no; the reason is printed."""
ABORTED = 4
"""Accepted, but canceled or aborted before it was done."""
UNREACHABLE = 5
"""Nobody answers: the stack is down, or the link to it."""
