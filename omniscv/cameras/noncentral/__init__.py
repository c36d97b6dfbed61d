"""Cameras whose rays do not meet in one point."""
