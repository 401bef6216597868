"""Where events come from: a flight log, later cameras and links; all tell time in their data."""
