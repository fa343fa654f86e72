"""Videos and folders of images, decoded with the container's own timestamps."""
