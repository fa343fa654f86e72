"""Effects of the mechanism itself: its parameters, friction, memory, contact and missing parts.

One file each; see `lagsplat.diagnose.effects.base` for what a file defines.
"""
