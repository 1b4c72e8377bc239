"""Training: configuration, one pure step, the loop around it, checkpoints, logs."""
