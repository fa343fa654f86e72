"""What only recordings with images have: their own faults, and the place in the image where a gap shows.

`video_checks` judges the video (`measure_camera_shift`, `drop_unusable_frames`), `rendering` draws images
from latents (`render_latents`, `find_body_points`), and `localization` finds the excess error and the point
that a force acts on (`compute_excess_error`, `localize_force`).
"""
