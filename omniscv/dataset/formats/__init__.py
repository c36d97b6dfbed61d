"""One module per format, of the format's name: it registers a :class:`omniscv.dataset.Format`."""
