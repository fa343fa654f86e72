"""Effects of camera and clock, which leave the mechanism as it is.

One file each; see `lagsplat.diagnose.effects.base` for what a file defines.
"""
