"""What every test shares: hypothesis without deadlines (the first call of a kernel compiles it).

The same examples in every run, so that a run tells of the change it is about; other ones by
`pytest --hypothesis-profile explore`.
"""

from hypothesis import HealthCheck, settings

SHARED = {"deadline": None, "max_examples": 60, "suppress_health_check": [HealthCheck.too_slow]}
settings.register_profile("tagvio", derandomize=True, **SHARED)
settings.register_profile("explore", **SHARED)
settings.load_profile("tagvio")
