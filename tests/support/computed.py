"""A source whose captures a function computes."""

import numpy as np

from omniscv.sources.base import Capabilities, Capture, ObjectTable, Source


class Computed(Source):
    """Captures whose pixels are ``compute(view)``."""

    capabilities = Capabilities()

    def __init__(self, compute):
        self._compute = compute

    def objects(self):
        return ObjectTable({})

    def capture(self, requests):
        for request in requests:
            yield Capture(request, request.view, np.asarray(self._compute(request.view)))
