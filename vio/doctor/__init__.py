"""Looks at a flight controller and says in plain words what is wrong, why, and what to set."""
