"""What a video's own frames say of it: camera motion, cuts, exposure, loops, frame rate, foreign objects.

`assessment` asks everything of one video (`assess_video`, `VideoAssessment`); the other modules answer one
question each.
"""
