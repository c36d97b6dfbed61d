"""Captures: single pictures and where they come from. Knows no camera model."""
