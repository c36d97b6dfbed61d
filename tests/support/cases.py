"""How many cases hypothesis draws: a share of the suite's, ten times as many with ``--soak``."""

from hypothesis import settings

_SUITE = 100  # what the suite's profile draws; the soak's draws more


def cases(count):
    """A decorator: so many cases, or ten times as many."""
    default = settings.get_profile(settings.get_current_profile_name()).max_examples
    return settings(max_examples=count if default <= _SUITE else 10 * count)
