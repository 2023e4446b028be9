"""Maps from pictures: a coverage's dataset in, an orthomosaic out. Axes of arrays are (north, east, down) in metres."""

from jezero.base.extras import require

require("jezero.mapping", "scipy", "cv2", "numpy")
