"""Lines in space from one non-central image."""
