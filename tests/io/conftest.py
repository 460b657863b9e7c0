"""How many random files each test of a reader is given, the same in every run."""

from hypothesis import HealthCheck, settings

settings.register_profile(
    "files",
    max_examples=60,
    deadline=None,
    database=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow, HealthCheck.data_too_large],
)
settings.load_profile("files")
