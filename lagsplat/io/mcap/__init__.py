"""MCAP logs: images, joint states and numbers of robots, read even if cut short, and sessions written.

`recording` reads a log as a recording (`read_mcap`, `survey_mcap`), `messages` and `images` decode it,
`recovery` reads the intact part of a damaged file, and `write` writes logs (`write_mcap`).
"""
