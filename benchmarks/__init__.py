"""What the step costs: run as `python -m benchmarks`."""

import os

# SciPy's vectors are too short for the threads of its BLAS to pay, and a thread of OpenBLAS that has nothing to do
# spins: it would take one core from whatever is measured next.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
