"""Pictures composed from captures."""
