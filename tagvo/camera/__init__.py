"""Cameras: the projection model, and reading it from calibration files."""
