"""What the car and the controller talk about: types, parameters, paths, scenarios, topics, bags."""

import os

__version__ = "0.1.0"

# Small matrices gain nothing from a second thread, and results must not depend on the number of
# cores; OpenBLAS reads this when numpy is imported, so all our packages import this one first.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
