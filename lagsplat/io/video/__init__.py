"""Videos and folders of images, decoded with the container's own timestamps.

`read` reads them as a recording (`read_video`), `clips` finds the files of a path, `decode` decodes them,
and `image_sequence` writes and reads the layouts of external tools.
"""
