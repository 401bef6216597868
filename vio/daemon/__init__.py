"""Flies: the one loop of `tagvio run` between live or replayed sources and a flight controller."""
