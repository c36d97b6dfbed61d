"""From captures to images."""
