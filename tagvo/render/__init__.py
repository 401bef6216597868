"""Renders what a camera sees over a map: light, lens, motion and all that goes wrong."""
