"""A measurement as the filter's history keeps it: a row of numbers, its kind, and its verdict.

Row: kind, count, then the payload, which the module of that kind packs and unpacks and nobody else
indexes.
"""

POSE, CORNERS, STILL, ROTATION, CLOCK, OPEN = 0, 1, 2, 3, 4, 5
LAST_VISION = CORNERS  # kinds up to here come from the camera
HEAD = 2  # numbers before the payload

# what became of a measurement
PENDING, ACCEPTED, POSITION_ONLY, ROTATION_ONLY, REJECTED, SINGULAR = 0, 1, 2, 3, 4, 5
