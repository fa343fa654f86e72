"""Videos and folders of images, decoded with the container's own timestamps.

`read` opens one as frames (`read_video`), `clips` finds the files a path stands for, `decode` decodes them,
and `image_sequence` writes the layouts that external tools read.
"""
