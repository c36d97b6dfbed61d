"""One module per format: ``name``, ``write(frames, out, options)`` and ``refuses(camera)``."""
