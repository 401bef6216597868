"""What every test shares: hypothesis without deadlines (the first call of a kernel compiles it),
one thread of linear algebra.

The same examples in every run, so that a run tells of the change it is about; other ones by
`pytest --hypothesis-profile explore`.
"""

import os

from hypothesis import HealthCheck, settings

# Before NumPy is loaded, here and in what a test starts. The workers fill the cores: a second
# thread of linear algebra waits in a loop for its turn (a comparison took 7.4 s of CPU, and 5.3 s
# with one).
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

SHARED = {"deadline": None, "max_examples": 60, "suppress_health_check": [HealthCheck.too_slow]}
settings.register_profile("tagvio", derandomize=True, **SHARED)
settings.register_profile("explore", **SHARED)
settings.load_profile("tagvio")
