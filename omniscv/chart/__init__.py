"""Charts: speed against accuracy, growth, and the limits of camera models."""
