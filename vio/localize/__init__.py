"""The localizer: VO, filter and what they are compared with, driven by one loop."""
