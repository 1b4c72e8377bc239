"""Training: configuration, one pure step, the loop around it, checkpoints, logs."""

DEFAULT_WEIGHTS = "midi-general"  # by name: for scenes of every kind
