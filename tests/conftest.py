"""What every test shares: hypothesis without deadlines (the first call of a kernel compiles it)."""

from hypothesis import HealthCheck, settings

settings.register_profile(
    "tagvio", deadline=None, max_examples=60, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("tagvio")
