"""Property tests draw fixed examples in `make test`, and ten times as many random ones in `make
properties`."""

from hypothesis import settings

# the same examples on every machine
settings.register_profile("fixed", derandomize=True, deadline=None)
settings.register_profile(
    "random", derandomize=False, deadline=None, max_examples=1000, print_blob=True
)
settings.load_profile("fixed")  # pytest's --hypothesis-profile comes later and wins


def examples(count):
    """Draw ``count`` examples in the fixed profile, in proportion in others."""
    return settings(max_examples=count * settings.default.max_examples // 100)
