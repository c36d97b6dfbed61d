"""One module per truth that a dataset may hold: what registers it with :mod:`omniscv.dataset.truths`."""
