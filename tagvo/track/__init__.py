"""Tracks the tags that a prior pose puts into an image, in place of searching the whole image."""

from tagvo.track.tracker import Tracked, Tracker

__all__ = ["Tracked", "Tracker"]
