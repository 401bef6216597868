"""Where events come from: flight logs, live cameras and links; all tell time in their data."""
