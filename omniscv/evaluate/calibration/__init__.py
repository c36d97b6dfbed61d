"""Calibration of cameras of revolution from the images of straight lines."""
