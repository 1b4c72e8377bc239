"""Noise schedules and the two diffusion processes; no networks here."""
