"""Tests. BLAS is kept to one thread: beside other processes, threads that wait for it spin."""

import os

# Read once, when NumPy and SciPy are imported.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
