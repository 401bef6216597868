"""Simulated flights: a scenario becomes a flight log, with truth and all that goes wrong."""
