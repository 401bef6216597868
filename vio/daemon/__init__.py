"""Flies: the one loop of `vio.run` between live or replayed sources and a flight controller."""
