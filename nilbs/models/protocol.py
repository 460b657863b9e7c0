"""What the scoring protocol fixes; importing it loads no library."""

POINTS = 100_000  # in each frame
POSE_SETS = ("seen", "interpolated", "unseen", "far")
IOUS = ("iou_bbox", "iou_surface")  # at points uniform around the body, and at points near its surface
RESOLUTION = 128  # cells along the longest edge of the grid that surfaces are extracted on
