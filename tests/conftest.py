"""Shared by all tests."""

import os

# Before numpy is loaded: on small matrices BLAS threads spend their time waiting for each other.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
