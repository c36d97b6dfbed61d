"""The paper's evaluations: algorithms run on images with known truth, and scored by it."""
