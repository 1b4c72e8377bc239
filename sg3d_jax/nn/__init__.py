"""Flax linen modules; the only place where flax is imported."""
