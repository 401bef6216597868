"""A measurement as the filter's history keeps it: a row of numbers, its kind, and its verdict.

Row: kind, count, index of the camera (0 for what comes from none), then the payload, which the
module of that kind packs and unpacks and nobody else indexes.
"""

POSE, CORNERS, STILL, ROTATION, CLOCK, OPEN = 0, 1, 2, 3, 4, 5
LAST_VISION = CORNERS  # kinds up to here come from the camera
KIND, COUNT, CAMERA, HEAD = 0, 1, 2, 3  # places in a row; the payload begins at HEAD

# what became of a measurement
PENDING, ACCEPTED, POSITION_ONLY, ROTATION_ONLY, REJECTED, SINGULAR = 0, 1, 2, 3, 4, 5
