"""Effects between the command and the mechanism, and forces from outside.

One file each; see `lagsplat.diagnose.effects.base` for what a file defines.
"""
