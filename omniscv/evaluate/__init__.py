"""The paper's evaluations: algorithms that are fed with images whose truth is known, and scored by it."""
