"""How many cases hypothesis draws where its profile's number is too small or too large."""

from hypothesis import settings

_SUITE = 100  # the suite's profile draws fewer, the soak's more


def cases(count):
    """A decorator: so many cases, or twenty times as many with ``--soak``."""
    default = settings.get_profile(settings.get_current_profile_name()).max_examples
    return settings(max_examples=count if default <= _SUITE else 20 * count)
