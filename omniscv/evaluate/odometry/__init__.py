"""Visual odometry on images of a flight."""
