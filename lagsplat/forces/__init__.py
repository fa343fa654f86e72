"""Forces given in the image or in space: grasps, generalised forces, and the law's answer."""
