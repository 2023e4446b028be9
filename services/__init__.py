"""The services of the stack; they never import each other."""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
"""Before SciPy loads it: the matrices of a service are small, and threads that wait for each other over them cost a
hundred times what they do where the cores have other work."""
