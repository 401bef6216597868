"""Judges trajectories against truth: errors, consistency, comparison, report."""
