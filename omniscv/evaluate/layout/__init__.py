"""Room layouts in panoramas: scores of predictions, beside the paper's of CFL."""
