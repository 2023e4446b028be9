"""Exit codes of the commands; 0 is success."""

FAILED = 1
"""Any other failure."""
USAGE = 2
"""Wrong use of the command line; click's own code."""
REFUSED = 3
"""The vehicle refused, or a stack runs already; the reason is printed."""
ABORTED = 4
"""Accepted, then canceled or aborted."""
UNREACHABLE = 5
"""No reply: the stack does not run, or the connection to it is lost."""
INCOMPLETE = 6
"""The mission has ended, and some of its steps were left out."""
