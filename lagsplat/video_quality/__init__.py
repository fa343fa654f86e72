"""Quality checks of a video: camera motion, cuts, exposure, loops, frame rate, foreign objects.

`assessment` runs all checks on one video (`assess_video`, `VideoAssessment`); the other modules hold them.
"""
